"""The command `fleet fit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import click

from fleet.cli.declare import command
from fleet.cli.types import (
    FILE,
    TIME,
    NoProgress,
)
from fleet.errors import FleetError
from fleet.option import Option
from fleet.terminal.progress import showing_steps
from fleet.terminal.width import say

if TYPE_CHECKING:
    from fleet.addons.robots.link_fit import LinkFit


@command()
def fit(
    trace: Annotated[Path, FILE],
    *,
    states: Annotated[Literal["1", "2", "3"], Option(
        "How many states; 1 is one condition, for losses that come alone.")] = "2",
    interval: Annotated[int | None, TIME, Option("Between two packets; by default the median in the trace.")] = None,
    picture: Annotated[Path | None, FILE, Option(
        "Draw the lengths of bursts, of TRACE and of the fit, into this file (png, svg, pdf).")] = None,
    quiet: NoProgress = False,
) -> None:  # fmt: skip
    """Fit link states to what TRACE (CSV) says was delivered, and print them for a scenario.

    The states are those of a hidden Markov model (Gilbert and Elliott), fitted by expectation maximisation. So a long
    study need not repeat one afternoon. The entry of network.links is printed on stdout, all else on stderr.

    \b
    Examples:
      fleet fit modem-log.csv
      fleet fit modem-log.csv --states 3 --picture bursts.png
      fleet fit links/1-2.csv > links.yaml
    """
    from fleet.addons.robots.link_fit import fit as fitted
    from fleet.scenario.sections.trace_table import read_trace
    from fleet.scenario.text.yaml_writer import yaml_text

    if trace.suffix != ".csv":
        raise click.BadParameter(f"expected a file that ends in .csv, got {trace}", param_hint="TRACE")
    if interval == 0:
        raise click.BadParameter("must be above 0", param_hint="--interval")
    if picture is not None and states == "1":
        raise click.UsageError("--picture compares bursts of losses: give --states 2 or 3")
    with showing_steps(f"{states} states"):
        try:
            found = fitted(read_trace(trace), int(states), interval)
        except FileNotFoundError:
            raise FleetError(f"trace {trace}: there is no such file") from None
    for text in fit_lines(found, trace):
        say(text, err=True)
    if picture is not None:
        _draw(found, trace, picture)
        say(str(picture), err=True)
    click.echo(yaml_text({"network": {"links": {"*": found.section()}}}), nl=False)


def fit_lines(found: LinkFit, trace: Path) -> list[str]:
    """The parameters of a fit in words, and how likely the trace is under it."""
    from fleet.addons.robots.link_fit import runs

    model, alone = found.model, found.independent
    every, share = found.interval_ns / 1e9, found.lost.mean()
    lines = [f"{trace}: {len(found.lost)} packets, one every {every:g} s, {100 * share:.3g} % lost"]
    if model.states > 1:
        lines += [
            f"log-likelihood {model.log_likelihood:.2f} with {model.states} states (BIC {model.bic:.1f}), "
            f"{alone.log_likelihood:.2f} with independent losses (BIC {alone.bic:.1f}); the lower BIC is the better",
            f"mean burst of losses: {runs(found.lost).mean():.3g} packets in the trace, {model.bursts(1)[1]:.3g} of "
            f"the fit, {1 / (1 - share):.3g} of independent losses",
        ]
    for k, name in enumerate(found.names):
        c = found.conditions[k]
        delay = f", delay {c.delay_ns / 1e6:.4g} ms, sd {c.jitter_ns / 1e6:.3g} ms" if c.delay_ns else ""
        rate = f", rate {c.rate_bit_s} bit/s" if c.rate_bit_s else ""
        lines.append(
            f"{name}: {100 * found.shares[k]:.3g} % of the time, mean {found.mean_ns[k] / 1e9:.4g} s, "
            f"loss {100 * c.loss:.3g} %{delay}{rate}"
        )
    if found.uneven:
        lines.append(
            "the packets are not evenly spaced: the states are fitted per packet, and times follow from the interval"
        )
    if found.lag > 0.01:
        lines.append(
            "no states in continuous time fit these changes from packet to packet exactly: probabilities differ by up "
            f"to {100 * found.lag:.2g} %; try --states 2"
        )
    return lines


def _draw(found: LinkFit, trace: Path, picture: Path) -> None:
    from fleet.addons.pictures.bursts import draw_bursts
    from fleet.addons.robots.link_fit import runs

    measured = {"burst of losses": runs(found.lost), "gap between bursts": runs(1.0 - found.lost)}
    longest = int(max(lengths.max() for lengths in measured.values())) + 1
    named = {f"fit of {found.model.states} states": found.model, "independent losses": found.independent}
    models = {
        name: dict(zip(measured, (model.bursts(longest)[0], model.gaps(longest)[0]), strict=True))
        for name, model in named.items()
    }
    draw_bursts(picture, trace.name, measured, models)
