"""Rules on periods and times: each is a whole number of ticks."""

from __future__ import annotations

from fleet.quantities import show_time
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report, whole_multiple
from fleet.scenario.sections.per_vehicle import qp_period_ns, used_keys


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
        if "qp_period" not in used_keys("guidance", law) or period % spec.tick == 0:
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
