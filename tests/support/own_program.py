"""A program of one's own as every agent of a small fleet, and what it has printed."""

from __future__ import annotations

from collections.abc import Callable
from textwrap import dedent

from fleet.result.result import Result

RunProgram = Callable[..., Result]


def scenario(arguments: str = '["{id}"]', vehicles: int = 2, signal: str = "v", **changes: str) -> str:
    """A moored fleet whose agents all run `program.py`, with further keys of `agent`."""
    text = dedent(f"""
        name: own
        title: a program
        vehicles: {vehicles}
        moored: true
        tick: 10 ms
        duration: 3 s
        graph: {{shape: complete}}
        network: {{period: 10 ms, links: {{"*": delay 20ms}}}}
        agent:
          program: program.py
          arguments: {arguments}
          signals: {{{signal}: '(?P<value>-?[0-9.]+) {signal}$'}}
    """).strip()
    return text + "".join(f"\n  {key}: {value}" for key, value in changes.items()) + "\n"


def lines(result: Result, agent: int = 1) -> list[str]:
    """What an agent's program has printed, without the times."""
    assert result.directory is not None
    text = (result.directory / "log" / f"agent-{agent}.log").read_text("utf-8")
    return [line.partition(" ")[2] for line in text.splitlines()]
