"""The report as Markdown and JSON: everything in it comes from the runs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from fleet.reproduce.cases import CASES, NAMES, SEAS, SHORT_S, Outcome
from fleet.reproduce.claims import Claim
from fleet.reproduce.figures import FIGURES

Outcomes = Mapping[str, Outcome]

_HEADINGS = (
    "run", "settle to 10 % [s], UUV 1-4", "settle to 5 cm [s]", "RMS e, last 10 s [m]", "RMS z, UUV 1",
    "demand at t = 0, UUV 1 [N / N m / N m]", "peak demand, UUV 1", "surge effort 0-2 s / all, UUV 1 [N s]",
    "max u_cmd, UUV 1 / fleet [m/s]", "first step of rho, UUV 1 [m/s]",
)  # fmt: skip


def write(folder: Path, outcomes: Outcomes, claims: Sequence[Claim], network: str, drawn: Sequence[str]) -> Path:
    """Write report.md and metrics.json; returns the report's path."""
    (folder / "metrics.json").write_text(
        json.dumps(
            {
                "cases": {
                    name: {
                        "what": CASES[name].what,
                        "overrides": list(CASES[name].overrides),
                        "broken": outcome.broken,
                        "vehicles": [_plain(row) for row in outcome.metrics],
                    }
                    for name, outcome in outcomes.items()
                },
                "claims": [asdict(claim) | {"verdict": claim.verdict} for claim in claims],
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
        f"{len(outcomes)} runs; no number here was typed in. How the paper was read, gap by gap: `docs/paper.md`. All "
        "runs but the one over the network use `network: ideal`, the zero latency that the paper assumes; Ts = 10 ms, "
        f'60 s ({SHORT_S} s under "Other readings").',
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
        rows = ([c.reading, c.asks, "yes" if c.holds else "no", c.numbers] for c in claim.checks)
        lines += [*_table(("reading", "asked", "holds", "numbers"), rows), ""]
    lines += ["## The paper's simulation", ""]
    lines += _runs(outcomes, [f"{name}-{sea}" for sea in SEAS for name in NAMES])
    lines += ["## Corrected cost (profile *consistent*)", ""]
    lines += _runs(outcomes, [name for name in outcomes if CASES[name].group == "consistent"])
    lines += ["## Over a network", "", network, ""]
    lines += _runs(
        outcomes, [name for sea in SEAS for name in (f"NBOC-{sea}", f"NBOC-network-{sea}") if name in outcomes]
    )
    lines += ["## Other readings", ""]
    others = [name for name in outcomes if CASES[name].group in ("sensitivity", "unlimited")]
    lines += [f"* {name}: {CASES[name].what}" for name in others] + [""]
    lines += _runs(outcomes, others)
    lines += ["## Pictures", ""]
    for name in drawn:
        lines += [f"### {FIGURES[name][0]}", "", f"![{FIGURES[name][0]}]({name}.png)", ""]
    lines += [
        "## How the numbers are defined",
        "",
        "*settle*: first time after which the vehicle's consensus error stays below the limit to the end, the limit "
        "being 10 % of its initial error or 5 cm. *RMS*: over the last 10 s, every sample. *z*: root of the squared "
        "errors of speed, pitch rate and yaw rate. *demand*: before the actuator limits; at t = 0 the filters have "
        "seen one sample, so only ratios mean something. *effort*: integral of the applied surge force's magnitude.",
    ]
    return lines


def _runs(outcomes: Outcomes, names: Iterable[str]) -> list[str]:
    rows = []
    for name in names:
        if name not in outcomes:
            continue
        outcome = outcomes[name]
        if outcome.broken:
            rows.append([name, f"ended early: {outcome.broken}", *[""] * 8])
            continue
        m = outcome.metrics
        first = m[0]
        rows.append(
            [
                name,
                " ".join(_time(row["settle_10pct_s"], ".2f") for row in m),
                " ".join(_time(row["settle_5cm_s"], ".1f") for row in m),
                " ".join(f"{row['e_rms_m']:.4f}" for row in m),
                f"{first['z_rms_mps']:.4f}",
                " / ".join(f"{value:.0f}" for value in first["demand_start"]),
                " / ".join(f"{value:.0f}" for value in first["demand_peak"]),
                f"{first['effort_first'][0]:.1f} / {first['effort'][0]:.1f}",
                f"{first['u_cmd_max_mps']:.2f} / {max(row['u_cmd_max_mps'] for row in m):.2f}",
                f"{first['rho_first_step_mps']:.2f}",
            ]
        )
    return [*_table(_HEADINGS, rows), ""] if rows else []


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(headings), "|" + "---|" * len(headings), *(line(row) for row in rows)]


def _time(value: float | None, form: str) -> str:
    return "never" if value is None else format(value, form)


def _plain(row: dict[str, Any]) -> dict[str, Any]:
    """The same without numbers that JSON has no word for."""
    return {key: _finite(value) for key, value in row.items()}


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
