"""The report as Markdown and JSON: everything in it comes from the runs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.config import AgentConfig
from fleet.addons.paper.cases import CALM_LATE_S, CASES, FIRST_S, NAMES, PEAK_AFTER_S, SEAS, Outcome, U
from fleet.addons.paper.claims import Claim, each, show
from fleet.addons.paper.figures import FIGURES

if TYPE_CHECKING:
    pass


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
