"""The rules that the keys of a scenario must fulfil together.

Each rule looks at a few keys and reports what does not fit. A rule stops when it reads a value that is wrong by itself
(`UnknownValueError`): that mistake is reported already. The other rules go on.
"""

from __future__ import annotations

from collections.abc import Callable

from fleet.quantities import show_time
from fleet.scenario.parts import Parts, UnknownValueError
from fleet.scenario.rules import checks, faults, laws, motion, network, nodes
from fleet.scenario.rules.report import Report, whole_multiple
from fleet.scenario.schema.spec import sections
from fleet.scenario.sections.per_vehicle import qp_period_ns, used

# --- periods and times: what must be whole ticks


def duration(parts: Parts, report: Report) -> None:
    spec = parts.spec
    whole_multiple(report, ("duration",), spec.duration, spec.tick)


def network_period(parts: Parts, report: Report) -> None:
    spec = parts.spec
    if not spec.network.ideal:
        whole_multiple(report, ("network", "period"), spec.network.period, spec.tick)


def qp_period(parts: Parts, report: Report) -> None:
    spec = parts.spec
    for entries, law, section, name in parts.guidance():
        period = qp_period_ns(name, section, spec.tick)
        if "qp_period" not in used("guidance", law) or period % spec.tick == 0:
            continue
        path = report.origin(entries, "guidance", "qp_period")
        if path is not None:
            whole_multiple(report, path, period, spec.tick)
        else:
            report.add(
                ("tick",),
                f"the QP period of profile {name}, {show_time(period)}, is not a whole number of ticks "
                f"of {show_time(spec.tick)}",
                "choose a tick that divides it, or set guidance.qp_period",
            )


def policies(parts: Parts, report: Report) -> None:
    spec = parts.spec
    if spec.network.ideal and spec.on_controller_error == "die":
        message = "the others of an ideal network wait for everybody, also for an agent that is gone"
        report.add(("on_controller_error",), message, "abort, coast, or give the network a period")
    if spec.network.ideal and spec.agents.per_process not in ("auto", 1):
        message = "nobody shares a process on an ideal network, which runs in one"
        report.add(("agents", "per_process"), message, "leave it out, or give the network a period")
    for path, external in sections(parts.spec, "external"):
        if external and spec.network.ideal:
            message = "nobody can join an ideal network, which runs in one process"
            report.add((*path, "external"), message, "give the network a period")


def check(parts: Parts, report: Report) -> None:
    """Report every mistake that a rule finds."""
    with_nodes = "nodes" in report.root.entries
    for rule in RULES:
        if with_nodes and rule in OF_VEHICLES:
            continue
        try:
            rule(parts, report)
        except UnknownValueError:
            continue


RULES: tuple[Callable[[Parts, Report], None], ...] = (
    duration,
    network_period,
    policies,
    qp_period,
    motion.reference,
    motion.formation,
    motion.initial,
    motion.graph_form,
    motion.edges,
    motion.followers,
    motion.knowledge,
    network.links,
    network.link_conditions,
    network.radios,
    network.acoustic,
    network.talking,
    nodes.nodes,
    nodes.contents,
    laws.per_vehicle,
    motion.moored,
    motion.navigation,
    faults.faults,
    faults.nemesis,
    checks.checks,
    checks.max_age,
    checks.connected,
    checks.recovery_time,
    laws.laws,
    laws.plants,
    motion.localization,
    motion.faults,
    checks.signal,
    checks.triggers,
    checks.python,
    checks.names,
    laws.effective,
    laws.rolls,
    laws.keep_apart,
    laws.vehicles,
    laws.velocity_bounds,
    laws.gain_bounds,
    laws.cosine_guard,
)

# What only vehicles of ours have.
OF_VEHICLES = frozenset(rule for rule in RULES if rule.__module__ == laws.__name__) | {qp_period, motion.localization}
