"""All cases in parallel, then the pictures, the verdicts and the report."""

from __future__ import annotations

import json
import math
import multiprocessing
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.config import AgentConfig
from fleet.addons.paper.cases import CALM_LATE_S, CASES, FIRST_S, NAMES, PEAK_AFTER_S, SEAS, Outcome, U, run_case
from fleet.addons.paper.claims import Claim, each, judge, show
from fleet.addons.paper.figures import FIGURES, draw
from fleet.errors import FleetError
from fleet.processes.interrupts import HungUp
from fleet.processes.workers import TIMES, WorkerDied, Workers
from netem.private_folder import PrivateFolder

if TYPE_CHECKING:
    from fleet.result.result import Result


# The report as Markdown and JSON: everything in it comes from the runs.


HEADINGS = ("parameter", *NAMES)

Value = Callable[[AgentConfig], str]


def table_1() -> list[list[str]]:
    """Its rows, in its order; what a controller does not have is N/A."""
    return _rows(
        ("K_1 [1/s]", lambda c: _diag(c.guidance.K0)),
        ("K_2 = (k_u, k_q, k_r)", lambda c: _diag((c.tracking.k_u, c.tracking.k_q, c.tracking.k_r))),
        ("Q", _optimal(lambda c: _diag(c.guidance.Q))),
        ("R_1", _optimal(lambda c: _diag(c.guidance.R1))),
        ("R_2", _optimal(lambda c: _diag(c.guidance.R2))),
        ("p_1, p_2, p_3", _optimal(lambda c: ", ".join([f"{c.guidance.p:g}"] * 3))),
        ("a [1/s]", _neurodynamic(lambda c: f"{c.tracking.a:g}")),
        ("b", _neurodynamic(lambda c: f"{c.tracking.b_up:g}")),
        ("d (b')", _neurodynamic(lambda c: f"{c.tracking.b_down:g}")),
    )


def chosen() -> list[list[str]]:
    """Values that the paper does not print and a run needs."""
    return _rows(
        ("k_theta, k_psi [1/s]", lambda c: f"{c.tracking.k_theta:g}, {c.tracking.k_psi:g}"),
        ("rho from [m/s]", _optimal(lambda c: _list(c.guidance.rho_lo))),
        ("rho to [m/s]", _optimal(lambda c: _list(c.guidance.rho_hi))),
        ("K from, to [1/s]", _optimal(lambda c: f"{c.guidance.k_min:g}, {c.guidance.k_max:g}")),
        (
            "optimised every, predicted [s]",
            _optimal(lambda c: _list((c.guidance.qp_ticks * c.tick_ns / 1e9, c.guidance.horizon_s))),
        ),
        ("filter of derivatives [s]", lambda c: f"{c.tracking.tau_f:g}"),
        ("boundary layer phi", _law("tracking", "sliding-mode", lambda c: _list(c.tracking.phi))),
        ("actuators [N, N m, N m]", lambda c: _list(c.tau_max)),
    )


def _rows(*rows: tuple[str, Value]) -> list[list[str]]:
    configs = [CASES[f"{name}-{U}"].scenario().agent_config(1) for name in NAMES]
    return [[symbol, *(value(config) for config in configs)] for symbol, value in rows]


def _law(kind: str, name: str, value: Value) -> Value:
    return lambda config: value(config) if getattr(config, f"{kind}_law").name == name else "N/A"


def _optimal(value: Value) -> Value:
    return _law("guidance", "optimal", value)


def _neurodynamic(value: Value) -> Value:
    return _law("tracking", "neurodynamic", value)


def _list(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _diag(values: Iterable[float]) -> str:
    return f"diag({_list(values)})"


Outcomes = Mapping[str, Outcome]

_HEADINGS = (
    "run", "settle to 10 % [s], UUV 1-4", "settle to 5 cm [s]", "RMS e late [m]", "largest e late [m]",
    "RMS z late", f"peak z after {PEAK_AFTER_S:g} s", "demand at t = 0, UUV 1 [N / N m / N m]", "peak demand, UUV 1",
    f"surge effort 0-{FIRST_S:g} s / all, UUV 1 [N s]", "max u_cmd, UUV 1 / fleet [m/s]",
    "first step of rho, UUV 1 [m/s]", "largest pitch [deg]",
)  # fmt: skip

_DEFINITIONS = (
    "Four numbers in a row are those of UUV 1 to 4. *settle*: first time after which the vehicle's consensus error "
    "stays below the limit to the end, the limit being 10 % of its initial error or 5 cm; *not settled* if it was "
    "above in the last two periods of the disturbance, or the last tenth of the run. *late*: over the last "
    f"{CALM_LATE_S:g} s undisturbed, over the whole periods in the second half of the run disturbed; every sample. "
    "*z*: root of the squared errors of speed, pitch rate and yaw rate. *peak z*: the largest after "
    f"{PEAK_AFTER_S:g} s. *demand*: before the actuator limits; at t = 0 the filters have seen one sample, so only "
    "ratios mean something. *effort*: integral of the applied force's or moment's magnitude. *tumbled*: pitch beyond "
    "80 deg."
)


def write(folder: Path, outcomes: Outcomes, claims: Sequence[Claim], network: str, drawn: Sequence[str]) -> Path:
    """Write report.md and metrics.json; returns the report's path."""
    (folder / "metrics.json").write_text(
        json.dumps(
            {
                "cases": {
                    name: {
                        "what": CASES[name].what,
                        "overrides": list(CASES[name].overrides),
                        "failure": outcome.failure,
                        "vehicles": _finite(outcome.metrics),
                    }
                    for name, outcome in outcomes.items()
                },
                "claims": [_claim(claim) for claim in claims],
                "network": network,
            },
            indent=2,
            allow_nan=False,
        )
        + "\n",
        "utf-8",
    )
    path = folder / "report.md"
    path.write_text("\n".join(_lines(outcomes, claims, network, drawn)) + "\n", "utf-8")
    return path


def _lines(outcomes: Outcomes, claims: Sequence[Claim], network: str, drawn: Sequence[str]) -> list[str]:
    lines = [
        "# The paper's simulation section, run again",
        "",
        "T. Yan, Z. Xu, S. X. Yang, S. A. Gadsden, *Distributed Neurodynamics-Based Backstepping Optimal Control for "
        "Robust Constrained Consensus of Underactuated Underwater Vehicles Fleet*.",
        "",
        f"Made by `fleet reproduce` (uuv-fleet {version('uuv-fleet')}, piqp {version('piqp')}) from "
        f"{len(outcomes)} runs; no number here was typed in. How the paper was read, gap by gap: "
        "`docs/background/paper.md`. All runs but those over the network use `network: ideal`, "
        "the zero latency that the paper assumes; Ts = 10 ms.",
        "",
        "## Verdicts",
        "",
        *_table(
            ("claim", "where", "verdict", "under which reading"),
            ([claim.text, claim.where, f"**{claim.verdict}**", claim.readings] for claim in claims),
        ),
        "",
    ]
    for number, claim in enumerate(claims, start=1):
        lines += [f"### {number}. {claim.text}", "", f"**{claim.verdict}**. {claim.remark}".rstrip(), ""]
        rows = ([c.reading, c.asks, c.answer_text, c.numbers] for c in claim.checks)
        lines += [*_table(("reading", "asked", "answer", "numbers, UUV 1-4"), rows), ""]
    lines += ["## Table I: control parameters", "", "As the runs were given them.", ""]
    lines += [*_table(HEADINGS, table_1()), ""]
    lines += ["Not printed in the paper, and chosen (`docs/background/paper.md`):", ""]
    lines += [*_table(HEADINGS, chosen()), ""]
    lines += ["## The paper's simulation", ""]
    lines += _runs(outcomes, [f"{name}-{sea}" for sea in SEAS for name in NAMES])
    lines += ["## Corrected cost (profile *consistent*)", ""]
    lines += _runs(
        outcomes,
        [name for sea in SEAS for name in outcomes if CASES[name].group == "consistent" and CASES[name].sea == sea],
    )
    lines += ["## Over a network", "", network, ""]
    lines += _runs(
        outcomes, [name for sea in SEAS for name in (f"NBOC-{sea}", f"NBOC-network-{sea}") if name in outcomes]
    )
    lines += ["## Other readings", ""]
    others = [name for name in outcomes if CASES[name].group in ("no-k_max", "sensitivity", "exact", "unlimited")]
    lines += [f"* {name}: {CASES[name].what}" for name in others] + [""]
    lines += _runs(outcomes, others)
    lines += ["## Pictures", ""]
    for name in drawn:
        lines += [f"### {FIGURES[name][0]}", "", f"![{FIGURES[name][0]}]({name}.png)", ""]
    lines += [
        "## How the numbers are defined",
        "",
        _DEFINITIONS,
        "",
        "A check is judged for every vehicle and every controller it names: *yes* if it holds for all, *partly* with "
        "the count, *no* if for none. What is compared must differ by more than 2 %.",
    ]
    return lines


def _runs(outcomes: Outcomes, names: Iterable[str]) -> list[str]:
    rows = []
    for name in names:
        if name not in outcomes:
            continue
        outcome = outcomes[name]
        tumbled = f"; {outcome.tumbled}" if outcome.tumbled else ""
        if outcome.broken:
            rows.append([f"{name}{tumbled}", f"ended early: {outcome.broken}", *[""] * (len(_HEADINGS) - 2)])
            continue
        m = outcome.metrics
        first = m[0]
        rows.append(
            [
                f"{name}, {CASES[name].seconds} s{tumbled}",
                show(each(outcome, "settle_10pct_s"), ".2f"),
                show(each(outcome, "settle_5cm_s"), ".1f"),
                show(each(outcome, "e_rms_m"), ".4f"),
                show(each(outcome, "e_max_late_m"), ".4f"),
                show(each(outcome, "z_rms_mps"), ".4f"),
                show(each(outcome, "z_peak_mps"), ".2f"),
                " / ".join(f"{value:.0f}" for value in first["demand_start"]),
                " / ".join(f"{value:.0f}" for value in first["demand_peak"]),
                f"{first['effort_first'][0]:.1f} / {first['effort'][0]:.1f}",
                f"{first['u_cmd_max_mps']:.2f} / {max(row['u_cmd_max_mps'] for row in m):.2f}",
                f"{first['rho_first_step_mps']:.2f}",
                show(each(outcome, "theta_max_deg"), ".0f"),
            ]
        )
    return [*_table(_HEADINGS, rows), ""] if rows else []


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(headings), "|" + "---|" * len(headings), *(line(row) for row in rows)]


def _claim(claim: Claim) -> dict[str, Any]:
    checks = [asdict(check) | {"answer": check.answer} for check in claim.checks]
    return asdict(claim) | {"verdict": claim.verdict, "checks": checks}


def _finite(value: Any) -> Any:
    """The same without numbers that JSON has no word for."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


CHECK_S = 3  # simulated time of the distributed run that is compared with the in-process one

_shared: Any = None  # in a worker: simulated seconds of each case

OnProgress = Callable[[str, float], None]  # (what is going on, share of everything that is done)


def reproduce(
    folder: Path, jobs: int, names: Sequence[str], formats: tuple[str, ...], on_progress: OnProgress
) -> tuple[Path, list[Claim], dict[str, Outcome]]:
    """Run cases and write the report into `folder`. Raises FleetError: the folder cannot be written, or a worker
    died."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FleetError(f"cannot make {folder}: {error.strerror}") from None
    network = _network_check(on_progress) if any(CASES[name].group == "network" for name in names) else ""
    times = multiprocessing.get_context("spawn").Array("d", len(names))
    try:
        with Workers(jobs, partial(_share, times)) as workers:
            outcomes = _run_all(workers, names, times, on_progress)
            figures = [name for name in FIGURES if _possible(name, outcomes)]
            drawn = _draw_all(workers, figures, outcomes, folder, formats, on_progress)
    except WorkerDied:
        raise FleetError(f"a worker process died {TIMES} times; is there enough memory?") from None
    claims = judge(outcomes)
    try:
        return write(folder, outcomes, claims, network, drawn), claims, outcomes
    except OSError as error:
        raise FleetError(f"cannot write the report into {folder}: {error.strerror}") from None


def _share(times: Any) -> None:
    global _shared
    _shared = times


def _case(numbered: tuple[int, str]) -> Outcome:
    index, name = numbered

    def progress(seconds: float) -> None:
        _shared[index] = seconds

    return run_case(name, progress)


def _run_all(workers: Workers, names: Sequence[str], times: Any, on_progress: OnProgress) -> dict[str, Outcome]:
    lengths = [CASES[name].scenario().duration_ns / 1e9 for name in names]
    found: dict[str, Outcome] = {}

    def wait() -> None:
        simulated = sum(min(t, length) for t, length in zip(times, lengths, strict=True))
        on_progress(f"{len(found)} of {len(names)} runs, {simulated:.0f} of {sum(lengths):.0f} s simulated",
             0.85 * simulated / sum(lengths))  # fmt: skip

    for (index, name), future in workers.each(_case, enumerate(names), wait):
        found[name] = future.result()
        times[index] = lengths[index]
    return {name: found[name] for name in names}


def _possible(figure: str, outcomes: dict[str, Outcome]) -> bool:
    return any(CASES[name].sea == FIGURES[figure][1] for name in outcomes)


def _pictured(figure: str, outcomes: dict[str, Outcome]) -> dict[str, Outcome]:
    sea = FIGURES[figure][1]
    hidden = ("sensitivity", "exact", "unlimited")
    return {
        name: outcome
        for name, outcome in outcomes.items()
        if CASES[name].sea == sea and CASES[name].group not in hidden
    }


def _draw_all(
    workers: Workers,
    figures: Sequence[str],
    outcomes: dict[str, Outcome],
    folder: Path,
    formats: tuple[str, ...],
    on_progress: OnProgress,
) -> list[str]:
    drawn: dict[str, bool] = {}
    items = ((name, _pictured(name, outcomes)) for name in figures)
    for (name, _), future in workers.each(partial(draw, folder=folder, formats=formats), items):
        try:
            drawn[name] = future.result()
        except OSError as error:
            raise FleetError(f"cannot write {name} into {folder}: {error.strerror}") from None
        on_progress(f"{len(drawn)} of {len(figures)} pictures", 0.85 + 0.15 * len(drawn) / len(figures))
    return [name for name in figures if drawn[name]]


def _go_on(result: Result) -> None:
    """End everything if a signal ended a run. Raises KeyboardInterrupt, or the HungUp among them."""
    from fleet.result.result import Status

    if result.status is Status.HUNG_UP:
        raise HungUp
    if result.status is Status.INTERRUPTED:
        raise KeyboardInterrupt


def _network_check(on_progress: OnProgress) -> str:
    """A few seconds of the network case as real processes over zenoh, against the same in this process."""
    from fleet.execution.execute import execute
    from fleet.execution.options import Options
    from fleet.result.result import Status
    from fleet.scenario.loading import load_scenario

    on_progress("a distributed run, to compare with the in-process one", 0.0)
    case = CASES[f"NBOC-network-{U}"]
    scenario = load_scenario("ideal", ["checks={}", *case.overrides, f"duration={CHECK_S} s"])
    with PrivateFolder() as place:
        run = partial(execute, scenario)
        began = time.monotonic()
        over_zenoh = run(Options(place, quiet=True))
        seconds = time.monotonic() - began
        _go_on(over_zenoh)
        plain = run(Options(place, in_process=True, quiet=True))
        _go_on(plain)
    if over_zenoh.status is not Status.PASS:
        return f"The distributed run broke: {over_zenoh.reason}. The numbers below are from one process."
    same = over_zenoh.digest == plain.digest
    return (
        "NBOC as a distributed fleet at its least latency: every agent sends at every tick, what it sends is usable "
        "one tick (10 ms) later, neighbours are extrapolated with the velocity they sent (dead reckoning). The runs of "
        f"60 s below were made in one process; {CHECK_S} s of the same were also run as {scenario.vehicles} agent "
        f"processes, a world and a network process over zenoh (in {seconds:.1f} s): "
        + (
            f"the same log, message for message (digest {plain.digest[:16]})."
            if same
            else f"**the logs differ** ({over_zenoh.digest[:16]} against {plain.digest[:16]}): please report this."
        )
    )
