"""Shell completion, and the command that prints its shell part: scenarios, live runs, faults, and targets of faults.

click writes the shell's part (https://click.palletsprojects.com/en/stable/shell-completion/) and asks here for words.
An error gives no words: no user wants an error in the middle of typing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Literal

import click
from click.shell_completion import CompletionItem, get_completion_class

from fleet.cli.declare import command

Words = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]
RUNS = Path("runs")  # where `fleet run` puts them
CLOCK_WORDS = ("pause", "resume", "step", "speed")
_CONDITIONS = ("delay", "loss", "duplicate", "corrupt", "reorder", "rate", "limit", "down")


def _words(find: Callable[[click.Context], Iterable[str]]) -> Words:
    """A completion with those words of `find` that begin with what is typed; without any, if `find` fails."""

    def complete(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
        try:
            words = list(find(context))
        except Exception:
            return []
        return [CompletionItem(quote_for_shell(word)) for word in words if word.startswith(typed)]

    return complete


def quote_for_shell(word: str) -> str:
    """A word as the shell must get it."""
    # zsh and fish quote a word themselves. bash does not, and needs no quotes after an opened quote.
    current = os.environ.get("COMP_WORDS", "").rsplit(None, 1)[-1:]
    if "bash" not in os.environ.get("_FLEET_COMPLETE", "") or (current and current[0][:1] in ("'", '"')):
        return word
    # Two backslashes, because click's function reads the words with bash's `read`, which removes one.
    return "".join(f"\\\\{c}" if c in "<>*|&;() '\"" else c for c in word)


def scenarios(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Complete shipped scenarios; without one, files."""
    from fleet.scenario.catalogue import shipped_scenarios

    return names_or_files(shipped_scenarios(), typed)


def names_or_files(names: Iterable[str], typed: str) -> list[CompletionItem]:
    """Not both: bash takes one kind at a time."""
    found = [CompletionItem(name) for name in names if name.startswith(typed)]
    return found or [CompletionItem(typed, type="file")]


@_words
def runs(context: click.Context) -> Iterable[str]:
    """Names of live runs."""
    from fleet.execution.connection import live_runs

    return [found.name for found in live_runs()]


@_words
def published_runs(context: click.Context) -> Iterable[str]:
    """Names of live runs that are published."""
    from fleet.execution.connection import published_runs
    from fleet.execution.directory import OBSERVE

    return [directory.name for directory in published_runs(OBSERVE)]


@_words
def healing(context: click.Context) -> Iterable[str]:
    """The next words in `fleet heal`: a run if several live, and ids of the active faults."""
    from fleet.execution.connection import ask, live_runs

    given = context.params.get("words") or ()
    known = [found.name for found in live_runs()]
    if not given and context.params.get("run") is None and len(known) > 1:
        return known
    run = _run(context, *given[:1])
    return [fault["id"] for fault in ask(run, "faults")["faults"] if fault["active"]]


@_words
def clock(context: click.Context) -> Iterable[str]:
    """The next words in `fleet clock`."""
    given = context.params.get("words") or ()
    return () if given and given[-1] in CLOCK_WORDS else CLOCK_WORDS


@_words
def injection(context: click.Context) -> Iterable[str]:
    """The next words in `fleet inject`."""
    from fleet.scenario.faults.kind import FleetFaultKind, LinkFaultKind
    from fleet.scenario.faults.kinds import KINDS
    from fleet.scenario.faults.of_links import PartitionFault

    given = context.params.get("what") or ()
    named = given[:1] if given and given[0] not in KINDS else ()
    given = given[len(named) :]
    if not given:
        return [*KINDS]
    kind = KINDS[given[0]]
    if kind.section is not None and not kind.one_word:
        return [f"{info.alias or key}=" for key, info in kind.section.model_fields.items()]
    if len(given) > 1:
        return _CONDITIONS if kind.name == "link" else ()
    vehicles, links = _targets(_run(context, *named))
    match kind:
        case LinkFaultKind():
            both = [f"{a}<->{b}" for a, b in links if a < b and (b, a) in links]
            return ["*", *(f"{a}->{b}" for a, b in links), *both]
        case PartitionFault():
            from fleet.scenario.faults.partitions import NAMED_PARTITIONS

            isolated = [f"isolate:{i}" for i in range(1, vehicles + 1)]
            return [*NAMED_PARTITIONS[:-1], *isolated]
        case FleetFaultKind():
            return ()
    return [str(i) for i in range(1, vehicles + 1)]


def _targets(run: Any) -> tuple[int, tuple[tuple[int, int], ...]]:
    from fleet.scenario.loading import load_scenario

    scenario = load_scenario(run.directory / "scenario.yaml", imports=False)
    return scenario.vehicles, scenario.graph.links


def _run(context: click.Context, *named: str) -> Any:
    """The run of --run, or the run named by position."""
    from fleet.execution.connection import find

    return find(context.params.get("run") or next(iter(named), None))


@command()
def completion(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print a shell script for completion of commands, scenarios, live runs, links, vehicles and faults.

    \b
    Examples:
      eval "$(fleet completion bash)"           in ~/.bashrc
      eval "$(fleet completion zsh)"            in ~/.zshrc
      fleet completion fish > ~/.config/fish/completions/fleet.fish
    """
    cls = get_completion_class(shell)
    assert cls is not None  # click has all three
    click.echo(cls(click.get_current_context().find_root().command, {}, "fleet", "_FLEET_COMPLETE").source())
