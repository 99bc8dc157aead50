"""The claims of the paper's simulation section, each judged on the runs.

Every threshold stands here. Where the paper compares "with the other approaches", each of the others counts, and
every vehicle; where it speaks of errors, what is meant is both the root mean square and the largest.

A check belongs to a reading (the printed cost, the corrected cost, ...), says what it asks, and has the numbers of
the runs beside it. It asks once per vehicle, or per vehicle and controller compared with: *yes* if every answer is,
*no* if none is, else *partly*. So is a claim: reproduced if every check is a yes, not if every one is a no.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from fleet.addons.paper.cases import FIRST_S, NAMES, PEAK_AFTER_S, D, Outcome, U

CLOSE = 0.02  # numbers within 2 % of each other count as equal

Outcomes = Mapping[str, Outcome]


@dataclass(frozen=True, slots=True)
class ClaimCheck:
    """One question with its answers."""

    reading: str
    asks: str
    holds: tuple[bool, ...]
    numbers: str

    @property
    def answer(self) -> str:
        return "yes" if all(self.holds) else "partly" if any(self.holds) else "no"

    @property
    def answer_text(self) -> str:
        """The answer, and for *partly* the count."""
        return f"partly ({sum(self.holds)} of {len(self.holds)})" if self.answer == "partly" else self.answer


@dataclass(frozen=True, slots=True)
class Claim:
    """One sentence of the paper and what became of it."""

    text: str
    where: str
    checks: tuple[ClaimCheck, ...]
    remark: str = ""

    @property
    def verdict(self) -> str:
        return {"yes": "reproduced", "no": "not reproduced", "partly": "partly"}[_together(self.checks)]

    @property
    def readings(self) -> str:
        """Under which reading it holds, and under which it does not."""
        by_reading: dict[str, list[ClaimCheck]] = {}
        for check in self.checks:
            by_reading.setdefault(check.reading, []).append(check)
        return "; ".join(f"{reading}: {_summary(checks)}" for reading, checks in by_reading.items())


def _together(checks: Sequence[ClaimCheck]) -> str:
    answers = {check.answer for check in checks}
    return answers.pop() if len(answers) == 1 else "partly"


def _summary(checks: Sequence[ClaimCheck]) -> str:
    answers = [check.answer for check in checks]
    if len(set(answers)) == 1:
        return answers[0]
    return ", ".join(f"{answers.count(word)} {word}" for word in ("yes", "partly", "no") if word in answers)


def compare_with_others(
    o: Outcomes,
    reading: str,
    asks: str,
    mine: str,
    others: Iterable[str],
    key: str,
    *,
    factor: float = 1.0 - CLOSE,
    channel: int | None = None,
    vehicles: slice = slice(None),
    form: str = ".4f",
    unit: str = "",
) -> ClaimCheck:
    """Whether a number of each vehicle is less than `factor` of the same vehicle's with each other controller."""
    own = each(o[mine], key, channel)[vehicles]
    holds: list[bool] = []
    texts = [f"{pretty(mine)} {show(own, form)} {unit if any(x is not None for x in own) else ''}".rstrip()]
    for other in others:
        theirs = each(o[other], key, channel)[vehicles]
        less = [x is not None and x < factor * (inf if y is None else y) for x, y in zip(own, theirs, strict=True)]
        texts.append(f"{pretty(other)} {show(theirs, form)} ({sum(less)} of {len(less)})")
        holds += less
    return ClaimCheck(reading, asks, tuple(holds), "; ".join(texts))


def check_limit(reading: str, asks: str, values: Sequence[float], limit: float, numbers: str) -> ClaimCheck:
    """Whether every one of some numbers is below a limit."""
    return ClaimCheck(reading, asks, tuple(value < limit for value in values), numbers)


def unbeaten(o: Outcomes, reading: str, what: str, mine: str, others: Iterable[str], sea: str, key: str) -> ClaimCheck:
    """Whether the mean of the fleet is nowhere better by more than 2 %; who has not settled is not the best."""
    own = mean(o[mine], key)
    theirs = {name: mean(o[f"{name}-{sea}"], key) for name in others}
    holds = tuple(isfinite(own) and own <= (1.0 + CLOSE) * value for value in theirs.values())
    form = ".2f" if key.endswith("_s") else ".3g"
    numbers = ", ".join(f"{pretty(name)} {_or_not(value, form)}" for name, value in {mine: own, **theirs}.items())
    return ClaimCheck(reading, f"{what}, mean of the fleet: nobody beats NBOC by more than {CLOSE:.0%}", holds, numbers)


def each(outcome: Outcome, key: str, channel: int | None = None) -> list[Any]:
    return [row[key] if channel is None else row[key][channel] for row in outcome.metrics]


def mean(outcome: Outcome, key: str) -> float:
    """The mean over the fleet; infinite if a vehicle has not settled."""
    values = [inf if value is None else value for value in each(outcome, key)]
    return float(sum(values) / len(values))


def show(values: Sequence[float | None], form: str) -> str:
    if all(value is None for value in values):
        return "not settled"
    return (", " if None in values else " ").join(_or_not(inf if v is None else v, form) for v in values)


def _or_not(value: float, form: str) -> str:
    return "not settled" if value == inf else format(value, form)


def pretty(name: str) -> str:
    """A run's controller, with what is special about it."""
    words = name.split("-")
    special = {"consistent": " (corrected cost)", "k_max": " (no bound on K)"}
    return words[0] + "".join(text for word, text in special.items() if word in words)


PRINTED = "printed cost"
CORRECTED = "corrected cost"
NO_K_MAX = "printed cost, no bound on K"
LIMITED = "actuators limited to 20 N, 20 N m"
UNLIMITED = "no actuator limit"
OTHER_GAIN = "other gain"

FORMED_M = 1e-3  # "perfectly achieved"
ABOUT_HALF = 0.6  # "nearly twice small"
HALF = 0.5  # "relatively large", against what is confined
JUMP_MPS = 0.5  # an evident jump of a command of 0.7 m/s
INSIDE_MPS = 1e-6  # a bound is kept
ADJUSTED = 0.1  # 1/s: a gain that moved by less has not been adjusted
AT_REST = 0.05  # 1/s: a gain that moves by less has converged

OPTIMISED = ("NBOC", "BOC")
FIXED = ("NBC", "BC", "BSMC")
PAIRS = (("NBOC", "NBC"), ("BOC", "BC"))  # the same but for the optimisation
NEURODYNAMIC = ("NBOC", "NBC")
PLAIN = ("BOC", "BC", "BSMC")

UUVS_2_4 = slice(1, 4)
CHANNELS = (("surge", "N"), ("pitch", "N m"), ("yaw", "N m"))


def judge(outcomes: Outcomes) -> list[Claim]:
    claims = []
    for make in _CLAIMS:
        try:
            claims.append(make(outcomes))
        except KeyError:  # a run was left out with --case
            continue
    return claims


def _case_names(names: tuple[str, ...], sea: str) -> list[str]:
    return [f"{name}-{sea}" for name in names]


def _and(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _formation(o: Outcomes) -> Claim:
    checks = []
    for reading, infix in ((LIMITED, ""), (UNLIMITED, "-unlimited")):
        for name in NAMES:
            outcome = o[f"{name}{infix}-{U}"]
            late = each(outcome, "e_max_late_m")
            numbers = f"largest of the last 10 s {show(late, '.2g')} m"
            if outcome.failure:
                numbers = f"{outcome.failure}; {numbers}"
            asks = f"{name}: error below {FORMED_M * 1e3:g} mm late, no vehicle tumbled"
            holds = tuple(not outcome.failure and value < FORMED_M for value in late)
            checks.append(ClaimCheck(reading, asks, holds, numbers))
    return Claim(
        "The formation tracking objective is perfectly achieved by all five controllers (undisturbed).",
        "first case",
        tuple(checks),
        "Literally as printed (no actuator limit, no floor on the commanded speed) the fixed-gain controllers ask for "
        "a steep turn at once and tumble; the optimised ones do not.",
    )


def _convergence(sea: str, where: str) -> Callable[[Outcomes], Claim]:
    def claim(o: Outcomes) -> Claim:
        checks = [
            compare_with_others(
                o,
                reading,
                f"UUVs 2-4: {name} within {limit} before {_and(FIXED)}",
                f"{name}{infix}-{sea}",
                _case_names(FIXED, sea),
                key,
                vehicles=UUVS_2_4,
                form=".2f",
                unit="s",
            )
            for reading, infix in ((PRINTED, ""), (CORRECTED, "-consistent"))
            for name in OPTIMISED
            for key, limit in (("settle_10pct_s", "10 % of the initial error"), ("settle_5cm_s", "5 cm"))
        ]
        crossing = " Who keeps crossing 5 cm in every period of the disturbance has not settled, however long the run."
        return Claim(
            f"The controllers with online optimisation converge faster, clearly for UUVs 2-4 ({sea}).",
            where,
            tuple(checks),
            "The printed cost penalises rho instead of its difference from the reference velocity, so near the goal "
            "the gain falls to its floor (docs/background/paper.md, G10)." + (crossing if sea == D else ""),
        )

    return claim


def _effort(o: Outcomes) -> Claim:
    quantities = (
        ("demand_start", "demand at t = 0", ""),
        ("demand_peak", "peak demand", ""),
        ("effort_first", f"effort of the first {FIRST_S:g} s", " s"),
    )
    checks = [
        compare_with_others(
            o,
            PRINTED,
            f"{channel} {what}: {mine} at most {ABOUT_HALF} of {other}",
            f"{mine}-{U}",
            [f"{other}-{U}"],
            key,
            factor=ABOUT_HALF,
            channel=number,
            form=".1f",
            unit=unit + per,
        )
        for mine, other in PAIRS
        for key, what, per in quantities
        for number, (channel, unit) in enumerate(CHANNELS)
    ]
    return Claim(
        "The control effort needed at the start is about half of that of NBC and BC.",
        "first case, Fig. 5",
        tuple(checks),
        "In the surge that is demanded it is; the actuators are at their limit with all of them. In yaw each new gain "
        "kicks the commanded course. Demand is what the law asks for before the actuator limits, effort what it got.",
    )


def _jump(o: Outcomes) -> Claim:
    checks = []
    for mine, other in PAIRS:
        asks = f"first step of rho: {mine} at most {HALF} of {other}"
        name, theirs = f"{mine}-{U}", f"{other}-{U}"
        first = each(o[name], "rho_first_step_mps")
        later = each(o[name], "rho_step_max_mps")
        checks += [
            compare_with_others(
                o, PRINTED, asks, name, [theirs], "rho_first_step_mps", factor=HALF, form=".2f", unit="m/s"
            ),
            check_limit(PRINTED, f"{mine}: first step of rho below {JUMP_MPS} m/s", first, JUMP_MPS,
                    f"{show(first, '.2f')} m/s"),
            check_limit(PRINTED, f"{mine}: every later step below {JUMP_MPS} m/s", later, JUMP_MPS,
                    f"{show(later, '.2f')} m/s"),
        ]  # fmt: skip
    return Claim(
        "The online optimisation avoids an evident jump of the commanded speed.",
        "first case, Fig. 6",
        tuple(checks),
        "The step is less than half, but a weight R2 = 1 on it lets rho reach its bound within one or two "
        "optimisations.",
    )


def _boundedness(o: Outcomes) -> Claim:
    low, high = (0.1, -1.0, -1.25), (1.5, 1.0, 1.25)  # profile paper
    checks = []
    for name in OPTIMISED:
        outcome = o[f"{name}-{U}"]
        inside = tuple(
            all(a >= b - INSIDE_MPS for a, b in zip(row["rho_min_mps"], low, strict=True))
            and all(a <= b + INSIDE_MPS for a, b in zip(row["rho_max_mps"], high, strict=True))
            for row in outcome.metrics
        )
        speeds = f"speed commands up to {show(each(outcome, 'u_cmd_max_mps'), '.2f')} m/s"
        checks.append(ClaimCheck(PRINTED, f"{name}: rho within its bounds", inside, speeds))
        asks = f"largest commanded speed: {name} at most {HALF} of {_and(FIXED)}"
        checks.append(
            compare_with_others(
                o,
                PRINTED,
                asks,
                f"{name}-{U}",
                _case_names(FIXED, U),
                "u_cmd_max_mps",
                factor=HALF,
                form=".2f",
                unit="m/s",
            )
        )
    return Claim(
        "The velocity commands stay within a given interval, while NBC, BC and BSMC need a large velocity at first.",
        "first case, Fig. 6",
        tuple(checks),
        "Within the interval they are by construction: rho is a variable of the optimisation, with bounds.",
    )


def _gains(sea: str, text: str, where: str, remark: str) -> Callable[[Outcomes], Claim]:
    def claim(o: Outcomes) -> Claim:
        checks = []
        for axis, name in enumerate("xyz"):
            spans, late, means = (each(o[f"NBOC-{sea}"], key, axis) for key in ("K_span", "K_late_span", "K_late_mean"))
            if sea == U:
                moved = tuple(span >= ADJUSTED for span in spans)
                asks = f"K_{name} is adjusted: moves by {ADJUSTED} 1/s or more in the run"
                checks.append(ClaimCheck(PRINTED, asks, moved, f"span {show(spans, '.3f')} 1/s"))
            asks = f"K_{name} converges: moves by less than {AT_REST} 1/s late"
            numbers = f"mean {show(means, '.3f')} 1/s, span {show(late, '.3f')} 1/s"
            checks.append(check_limit(PRINTED, asks, late, AT_REST, numbers))
        return Claim(text, where, tuple(checks), remark)

    return claim


def _errors(o: Outcomes) -> Claim:
    checks = [
        compare_with_others(
            o,
            reading,
            f"{what}: {name} below {_and(FIXED)}",
            f"{name}{infix}-{D}",
            _case_names(FIXED, D),
            key,
            unit="m",
        )
        for reading, infix in ((PRINTED, ""), (CORRECTED, "-consistent"), (NO_K_MAX, "-no-k_max"))
        for name in OPTIMISED
        for key, what in (("e_rms_m", "RMS consensus error late"), ("e_max_late_m", "largest consensus error late"))
    ]
    return Claim(
        "Under the disturbance NBOC and BOC have smaller consensus errors than the other three.",
        "second case, Fig. 8",
        tuple(checks),
        "Without a bound on K its x component drifts upwards under the periodic disturbance, which makes the errors "
        "smaller until the loop bursts: NBOC's does so after a minute (docs/background/paper.md, G11).",
    )


def _velocity_errors(o: Outcomes) -> Claim:
    unit = "m/s, rad/s"
    checks = [
        compare_with_others(
            o,
            PRINTED,
            f"{what}: {name} below {_and(PLAIN)}",
            f"{name}-{D}",
            _case_names(PLAIN, D),
            key,
            form=form,
            unit=unit,
        )
        for key, what, form in (
            ("z_rms_mps", "RMS z late", ".4f"),
            ("z_peak_mps", f"peak z after {PEAK_AFTER_S:g} s", ".2f"),
        )
        for name in NEURODYNAMIC
    ]
    checks += [
        compare_with_others(
            o, OTHER_GAIN, f"RMS z late: {text}", f"{mine}-{D}", [f"{other}-{D}"], "z_rms_mps", unit=unit
        )
        for mine, other, text in (
            ("NBC", "BC-K2-30", "NBC still smaller than BC with K2 = 30, the same gain at rest"),
            ("NBC", "BSMC-phi-0.1", "NBC still smaller than BSMC with a boundary layer of 0.1"),
            ("NBC-b-10", "BC", "NBC with b = 10 (gain 1 at rest) still smaller than BC"),
        )
    ]
    return Claim(
        "Under the disturbance the controllers with neurodynamics have apparently smaller velocity tracking errors z.",
        "second case, Fig. 9",
        tuple(checks),
        "True at rest and at the printed gains: it is the shunting model's gain at rest, b/a = 3, that does it. The "
        "peaks on the way there are another matter.",
    )


def _best(o: Outcomes) -> Claim:
    others = tuple(name for name in NAMES if name != "NBOC")
    checks = [
        unbeaten(o, reading, what, f"NBOC{infix}-{sea}", others, sea, key)
        for reading, infix in ((PRINTED, ""), (CORRECTED, "-consistent"))
        for what, sea, key in (
            ("settling time to 10 %", U, "settle_10pct_s"),
            ("settling time to 10 %, disturbed", D, "settle_10pct_s"),
            ("settling time to 5 cm", U, "settle_5cm_s"),
            ("settling time to 5 cm, disturbed", D, "settle_5cm_s"),
            ("RMS consensus error late, disturbed", D, "e_rms_m"),
            ("largest consensus error late, disturbed", D, "e_max_late_m"),
            ("RMS z late, disturbed", D, "z_rms_mps"),
            (f"peak z after {PEAK_AFTER_S:g} s, disturbed", D, "z_peak_mps"),
        )
    ]
    return Claim(
        "NBOC performs best in speed of convergence, steady accuracy, disturbance attenuation and constraints.",
        "end of the section",
        tuple(checks),
        "Constraints are judged above.",
    )


_CLAIMS: tuple[Callable[[Outcomes], Claim], ...] = (
    _formation,
    _convergence(U, "first case, Figs. 3, 4"),
    _effort,
    _jump,
    _boundedness,
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
