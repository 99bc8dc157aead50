"""Liveness: a core of the fleet is healed at some time, and everything else stays broken for ever.

A swarm acts on all vehicles up to the time of healing. Each vehicle outside the core breaks at a drawn time before it
and is never repaired: its agent ends, it is mute or deaf, or it is cut off. From then on the core must do what it
promises, and checks of what is to happen at last judge the core alone: what waits for the others waits for ever. Safety
is still asked of all vehicles. (TigerBeetle, "Simulation Testing For Liveness", 2023, has the idea.)
"""

from __future__ import annotations

from typing import Any

from fleet.quantities import vehicle_numbers
from fleet.scenario.schema.checks import ChecksSection, SignalCheck
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import NemesisSection
from fleet.scenario.sections import swarm
from fleet.scenario.sections.graph import neighbours
from fleet.scenario.sections.nemesis_targets import NemesisTargets, free_name
from netem.draws import bits, uniform

PURPOSE = "nemesis liveness"
_NETWORK = ("kill", "mute", "deaf", "partition")
_IDEAL = ("off",)
_CORE, _BREAKS, _WHEN = range(3)  # what is drawn


def heal_time(nemesis: NemesisSection, targets: NemesisTargets) -> int:
    """When the core is healed [ns]."""
    spec = targets.spec
    return spec.duration // 2 // spec.tick * spec.tick if nemesis.heal is None else nemesis.heal


def core(nemesis: NemesisSection, targets: NemesisTargets) -> list[int]:
    """The vehicles that are healed: those named, else a majority that links connect.

    If not all follow the reference, the core has a vehicle that does, because the others need it as a leader.
    """
    if nemesis.core is not None:
        return vehicle_numbers(nemesis.core)
    spec = targets.spec
    near = neighbours(targets.pairs)

    def drawn(i: int) -> tuple[float, int]:
        return uniform(spec.seed, PURPOSE, i, _CORE), i

    found = {min(targets.followers or range(1, spec.vehicles + 1), key=drawn)}
    while len(found) < spec.vehicles // 2 + 1:
        fresh = {j for i in found for j in near.get(i, ())} - found
        if not fresh:
            break
        found.add(min(fresh, key=drawn))
    return sorted(found)


def faults(nemesis: NemesisSection, targets: NemesisTargets) -> list[FaultSection]:
    """The faults: those of a swarm up to the heal, and the lasting ones."""
    spec, heal = targets.spec, heal_time(nemesis, targets)
    chaos = swarm.to_sections(swarm.draw(nemesis, targets, heal), targets)
    healthy, taken = set(core(nemesis, targets)), {fault.id for fault in spec.faults}
    stay: list[FaultSection] = []
    for i in range(1, spec.vehicles + 1):
        if i in healthy:
            continue
        kinds = _IDEAL if spec.network.ideal or not targets.links else _NETWORK
        kind = kinds[bits(spec.seed, PURPOSE, i, _BREAKS) % len(kinds)]
        start = nemesis.start or 0
        at = int(start + (heal - start) * uniform(spec.seed, PURPOSE, i, _WHEN)) // spec.tick * spec.tick
        name = free_name(f"broken-{i}", taken)
        body = {kind: f"isolate:{i}" if kind == "partition" else str(i)}
        stay.append(FaultSection.model_validate({"id": name, "at": f"{at} ns", **body}))
    return sorted([*chaos, *stay], key=lambda fault: fault.at)


def core_checks(checks: ChecksSection, nemesis: NemesisSection, targets: NemesisTargets) -> ChecksSection:
    """The checks of a scenario as they judge a core.

    Some checks count only from the heal on, and only for vehicles of the core. These are signals with
    `eventually_within` or `agree_within`, errors, times of recovery, and connections. All others stay as they are.
    """
    heal, some = heal_time(nemesis, targets), core(nemesis, targets)
    changes: dict[str, Any] = {}
    if checks.signal is not None:
        changes["signal"] = [_restrict_signal_check(check, some, heal) for check in checks.signal]
    for name in ("formation_error", "consensus_error", "connected"):
        if (check := getattr(checks, name)) is not None:
            after = max(check.after, heal)
            changes[name] = check.model_copy(update={"vehicles": _some(check.vehicles, some), "after": after})
    if checks.recovery_time is not None:
        changes["recovery_time"] = [
            check.model_copy(update={"vehicles": _some(check.vehicles, some)}) for check in checks.recovery_time
        ]
    return checks.model_copy(update=changes)


def _restrict_signal_check(check: SignalCheck, some: list[int], heal: int) -> SignalCheck:
    if check.eventually_within is None and check.agree_within is None:
        return check
    those = _some(check.vehicles, some)
    if len(vehicle_numbers(those)) < 2 and (check.agree_within is not None or check.spread_below is not None):
        those = check.vehicles or ""  # such a check compares vehicles
    return check.model_copy(update={"vehicles": those or None, "after": max(check.after, heal), "fault": None})


def _some(given: str | None, some: list[int]) -> str:
    """The vehicles of the core that a check names; all of the core if it names none of them."""
    both = [i for i in some if given is None or i in vehicle_numbers(given)]
    return ",".join(map(str, both or some))
