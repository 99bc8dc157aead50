"""The claims of the paper's simulation section, each judged on the runs.

A claim is broken into checks. A check belongs to a reading (the printed cost, the corrected cost, ...), says what it
asks, and has the numbers of the runs beside it. All checks hold: reproduced; some: partly; none: not reproduced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

from fleet.reproduce.cases import NAMES, D, Outcome, U

PRINTED = "printed cost"
CORRECTED = "corrected cost"
NO_K_MAX = "printed cost, no bound on K"
UNLIMITED = "no actuator limit"
OTHER_GAIN = "other gain"

CLOSE = 0.02  # numbers within 2 % of each other count as equal

Outcomes = Mapping[str, Outcome]


@dataclass(frozen=True, slots=True)
class Check:
    """One question with its answer."""

    reading: str
    asks: str
    holds: bool
    numbers: str


@dataclass(frozen=True, slots=True)
class Claim:
    """One sentence of the paper and what became of it."""

    text: str
    where: str
    checks: tuple[Check, ...]
    remark: str = ""

    @property
    def verdict(self) -> str:
        holding = sum(check.holds for check in self.checks)
        if holding == len(self.checks):
            return "reproduced"
        return "partly" if holding else "not reproduced"

    @property
    def readings(self) -> str:
        """Under which reading it holds, and under which it does not."""
        by_reading: dict[str, list[bool]] = {}
        for check in self.checks:
            by_reading.setdefault(check.reading, []).append(check.holds)
        words = {True: "yes", False: "no"}
        return "; ".join(
            f"{reading}: {words[all(holds)] if len(set(holds)) == 1 else f'{sum(holds)} of {len(holds)}'}"
            for reading, holds in by_reading.items()
        )


def judge(outcomes: Outcomes) -> list[Claim]:
    """Every claim whose runs are all there."""
    claims = []
    for make in _CLAIMS:
        try:
            claims.append(make(outcomes))
        except KeyError:  # a run was left out with --case
            continue
    return claims


def _each(outcome: Outcome, key: str) -> list[Any]:
    return [row[key] for row in outcome.metrics]


def _first(outcome: Outcome, key: str, channel: int | None = None) -> float:
    """A number of UUV 1, of which the paper shows the details."""
    value = outcome.metrics[0][key]
    return float(value if channel is None else value[channel])


def _show(values: Iterable[float | None], form: str) -> str:
    return " ".join("never" if value is None else format(value, form) for value in values)


def _faster(o: Outcomes, reading: str, a: str, b: str, key: str) -> Check:
    mine, theirs = _each(o[a], key)[1:], _each(o[b], key)[1:]
    means = [sum(inf if value is None else value for value in values) / len(values) for values in (mine, theirs)]
    holds = means[0] < (1.0 - CLOSE) * means[1]
    limit = {"settle_10pct_s": "10 % of the initial error", "settle_5cm_s": "5 cm"}[key]
    text = f"UUVs 2-4, in the mean: {_pretty(a)} within {limit} before {_pretty(b)}"
    return Check(reading, text, holds, f"{_show(mine, '.2f')} s against {_show(theirs, '.2f')} s")


def _pretty(name: str) -> str:
    words = name.split("-")
    return words[0] + (" (corrected cost)" if "consistent" in words else " (no bound on K)" if "k_max" in words else "")


def _smaller(o: Outcomes, reading: str, a: str, b: str, key: str, *, one: bool = False) -> Check:
    mine, theirs = _each(o[a], key), _each(o[b], key)
    if one:
        mine, theirs = mine[:1], theirs[:1]
    quantity = {"e_rms_m": "RMS consensus error, last 10 s", "z_rms_mps": "RMS z of UUV 1, last 10 s"}[key]
    unit = {"e_rms_m": "m", "z_rms_mps": "m/s, rad/s"}[key]
    holds = all(x < (1.0 - CLOSE) * y for x, y in zip(mine, theirs, strict=True))
    return Check(
        reading,
        f"{quantity}: {_pretty(a)} below {_pretty(b)}",
        holds,
        f"{_show(mine, '.4f')} {unit} against {_show(theirs, '.4f')} {unit}",
    )


def _formation(o: Outcomes) -> Claim:
    checks = []
    for name in NAMES:
        worst = max(_each(o[f"{name}-{U}"], "e_max_late_m"))
        broken = o[f"{name}-{U}"].broken
        checks.append(_achieved("actuators limited to 20 N, 20 N m", name, worst, broken))
    for name in NAMES:
        outcome = o[f"{name}-unlimited-{U}"]
        checks.append(_achieved(UNLIMITED, name, max(_each(outcome, "e_max_late_m")), outcome.broken))
    return Claim(
        "The formation tracking objective is perfectly achieved by all five controllers (undisturbed).",
        "first case",
        tuple(checks),
        "Literally as printed (no actuator limit, no floor on the commanded speed) the fixed-gain controllers ask for "
        "a steep turn at once and tumble; the optimised ones do not.",
    )


def _achieved(reading: str, name: str, worst: float, broken: str) -> Check:
    holds = not broken and worst < 1e-3
    numbers = f"run ended: {broken}" if broken else f"largest error of the last 10 s {worst:.2g} m"
    return Check(reading, f"{name}: error below 1 mm", holds, numbers)


def _convergence(sea: str, where: str) -> Callable[[Outcomes], Claim]:
    def claim(o: Outcomes) -> Claim:
        checks = [
            _faster(o, reading, f"{a}{infix}-{sea}", f"{b}-{sea}", key)
            for reading, infix in ((PRINTED, ""), (CORRECTED, "-consistent"))
            for a, b in (("NBOC", "NBC"), ("BOC", "BC"))
            for key in ("settle_10pct_s", "settle_5cm_s")
        ]
        return Claim(
            f"The controllers with online optimisation converge faster, clearly for UUVs 2-4 ({sea}).",
            where,
            tuple(checks),
            "The printed cost penalises rho instead of its difference from the reference velocity, so near the goal "
            "the gain falls to its floor (docs/paper.md, G10).",
        )

    return claim


def _effort(o: Outcomes) -> Claim:
    checks = []
    for a, b in (("NBOC", "NBC"), ("BOC", "BC")):
        for key, what in (("demand_start", "demand at t = 0"), ("demand_peak", "peak demand")):
            for channel, name, unit in ((0, "surge", "N"), (2, "yaw", "N m")):
                mine, theirs = _first(o[f"{a}-{U}"], key, channel), _first(o[f"{b}-{U}"], key, channel)
                checks.append(
                    Check(
                        PRINTED,
                        f"{name} {what}, UUV 1: {a} at most 0.6 of {b}",
                        mine <= 0.6 * theirs,
                        f"{mine:.1f} {unit} against {theirs:.1f} {unit} ({mine / theirs:.2f})",
                    )
                )
    return Claim(
        "The control effort needed at the start is about half of that of NBC and BC.",
        "first case, Fig. 5",
        tuple(checks),
        "In surge it is. In yaw each new gain kicks the commanded course.",
    )


def _bounded(o: Outcomes) -> Claim:
    checks = []
    for name in ("NBOC", "BOC"):
        outcome = o[f"{name}-{U}"]
        rho = outcome.signals["rho"]
        low, high = (0.1, -1.0, -1.25), (1.5, 1.0, 1.25)  # profile paper
        inside = all(
            float(rho[:-1, :, k].min()) >= low[k] - 1e-6 and float(rho[:-1, :, k].max()) <= high[k] + 1e-6
            for k in range(3)
        )
        worst = max(_each(outcome, "u_cmd_max_mps"))
        checks.append(Check(PRINTED, f"{name}: rho within its bounds", inside, f"speed commands up to {worst:.2f} m/s"))
    for a, b in (("NBOC", "NBC"), ("BOC", "BC")):
        mine, theirs = max(_each(o[f"{a}-{U}"], "u_cmd_max_mps")), max(_each(o[f"{b}-{U}"], "u_cmd_max_mps"))
        checks.append(
            Check(
                PRINTED,
                f"largest commanded speed of the fleet: {a} at most half of {b}",
                mine <= 0.5 * theirs,
                f"{mine:.2f} m/s against {theirs:.2f} m/s",
            )
        )
    return Claim(
        "The velocity commands stay within a given interval, while NBC, BC and BSMC need a large velocity at first.",
        "first case, Fig. 6",
        tuple(checks),
    )


def _jump(o: Outcomes) -> Claim:
    checks = []
    for a, b in (("NBOC", "NBC"), ("BOC", "BC")):
        mine, theirs = _first(o[f"{a}-{U}"], "rho_first_step_mps"), _first(o[f"{b}-{U}"], "rho_first_step_mps")
        numbers = f"{mine:.2f} m/s against {theirs:.2f} m/s"
        checks.append(
            Check(PRINTED, f"first step of rho, UUV 1: {a} at most half of {b}", mine <= 0.5 * theirs, numbers)
        )
        checks.append(Check(PRINTED, f"{a}: first step of rho below 0.5 m/s", mine < 0.5, f"{mine:.2f} m/s"))
    return Claim(
        "The online optimisation avoids an evident jump of the commanded speed.",
        "first case, Fig. 6",
        tuple(checks),
        "The step is less than half, but a weight R2 = 1 on it lets rho reach its bound within one or two "
        "optimisations.",
    )


def _gains(sea: str, text: str, where: str, remark: str) -> Callable[[Outcomes], Claim]:
    def claim(o: Outcomes) -> Claim:
        outcome = o[f"NBOC-{sea}"]
        checks = []
        for axis, name in enumerate("xyz"):
            spans = [row["K_late_span"][axis] for row in outcome.metrics]
            means = [row["K_late_mean"][axis] for row in outcome.metrics]
            checks.append(
                Check(
                    PRINTED,
                    f"K_{name} at rest over the last 10 s (spans less than 0.05 1/s)",
                    max(spans) < 0.05,
                    f"mean {_show(means, '.3f')} 1/s, span {_show(spans, '.3f')} 1/s",
                )
            )
        return Claim(text, where, tuple(checks), remark)

    return claim


def _errors(o: Outcomes) -> Claim:
    checks = [
        _smaller(o, reading, f"{a}{infix}-{D}", f"{b}-{D}", "e_rms_m")
        for reading, infix in ((PRINTED, ""), (CORRECTED, "-consistent"), (NO_K_MAX, "-no-k_max"))
        for a, b in (("NBOC", "NBC"), ("BOC", "BC"))
    ]
    return Claim(
        "Under the disturbance NBOC and BOC have smaller consensus errors.",
        "second case, Fig. 8",
        tuple(checks),
        "Without a bound on K its x component drifts upwards under the periodic disturbance, which helps until the "
        "loop bursts (docs/paper.md, G11).",
    )


def _velocity_errors(o: Outcomes) -> Claim:
    pairs = (("NBOC", "BOC"), ("NBC", "BC"), ("NBOC", "BSMC"), ("NBC", "BSMC"))
    checks = [_smaller(o, PRINTED, f"{a}-{D}", f"{b}-{D}", "z_rms_mps", one=True) for a, b in pairs]
    for name, base, text in (
        ("BC-K2-30", "NBC", "still smaller than BC with K2 = 30, the same gain at rest"),
        ("BSMC-phi-0.1", "NBC", "still smaller than BSMC with a boundary layer of 0.1"),
    ):
        mine, theirs = _first(o[f"{base}-{D}"], "z_rms_mps"), _first(o[f"{name}-{D}"], "z_rms_mps")
        numbers = f"{mine:.4f} against {theirs:.4f} m/s, rad/s"
        checks.append(Check(OTHER_GAIN, f"{base}: {text}", mine < (1.0 - CLOSE) * theirs, numbers))
    mine, theirs = _first(o[f"NBC-b-10-{D}"], "z_rms_mps"), _first(o[f"BC-{D}"], "z_rms_mps")
    numbers = f"{mine:.4f} against {theirs:.4f} m/s, rad/s"
    text = "NBC with b = 10 (gain 1 at rest): still smaller than BC"
    checks.append(Check(OTHER_GAIN, text, mine < (1.0 - CLOSE) * theirs, numbers))
    return Claim(
        "Under the disturbance the controllers with neurodynamics have apparently smaller velocity tracking errors z.",
        "second case, Fig. 9",
        tuple(checks),
        "True at the printed gains; it is the shunting model's gain at rest, b/a = 3, that does it.",
    )


def _best(o: Outcomes) -> Claim:
    others = [name for name in NAMES if name != "NBOC"]
    checks = []
    for reading, mine in ((PRINTED, "NBOC"), (CORRECTED, "NBOC-consistent")):
        speed, error, z = (
            {name: _mean(o[f"{name}-{sea}"], key) for name in (mine, *others)}
            for sea, key in ((U, "settle_10pct_s"), (D, "e_rms_m"), (D, "z_rms_mps"))
        )
        for what, values, form in (
            ("mean settling time to 10 %", speed, ".2f"),
            ("mean RMS consensus error, disturbed", error, ".4f"),
            ("mean RMS z, disturbed", z, ".4f"),
        ):
            best = all(values[mine] <= (1.0 + CLOSE) * values[name] for name in others)
            numbers = ", ".join(f"{name.split('-')[0]} {value:{form}}" for name, value in values.items())
            checks.append(Check(reading, f"{what}: nobody beats NBOC by more than 2 %", best, numbers))
    return Claim(
        "NBOC performs best in speed of convergence, steady accuracy, disturbance attenuation and constraints.",
        "end of the section",
        tuple(checks),
        "Constraints are judged above.",
    )


def _mean(outcome: Outcome, key: str) -> float:
    values = [inf if value is None else value for value in _each(outcome, key)]
    return sum(values) / len(values)


_CLAIMS: tuple[Callable[[Outcomes], Claim], ...] = (
    _formation,
    _convergence(U, "first case, Figs. 3, 4"),
    _effort,
    _jump,
    _bounded,
    _gains(
        U,
        "The gains adjust automatically and settle (undisturbed).",
        "first case, Fig. 7",
        "K_z settles at Q s / (R1 + Q s^2), s = c dt; K_x and K_y at their floor.",
    ),
    _convergence(D, "second case, Fig. 8"),
    _errors,
    _velocity_errors,
    _gains(
        D,
        "The gains converge smoothly even in the presence of disturbances.",
        "second case, Fig. 10",
        "K_z does. K_x cycles with the disturbance between its bounds.",
    ),
    _best,
)
