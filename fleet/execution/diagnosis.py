"""Why a run cannot go on: a process ended, with its last lines, or the run waits for a process."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from fleet.errors import RunBroken
from fleet.execution.notes import fold_notes, text_without_agent
from fleet.processes.children import (
    FORKSERVER_LOST,
    Child,
    Exit,
    describe_exit,
    forkserver_death,
    forkserver_suspended,
    has_ended,
    is_suspended,
)
from netem.wire.credentials import NETEM, WORLD, agent_role

MOST_NAMED = 8  # processes in a line
_REAPED_S = 2.0  # the sockets of a fork server that is killed close a moment before it can be reaped


def explain(
    exits: Sequence[Exit],
    children: Mapping[str, Child],
    notes: Sequence[str],
    at: str,
    computing: Callable[[str], int] = lambda _: 0,
) -> RunBroken:
    """The error for processes that ended at about the same time: which one ended first, how, and its last lines.

    Args:
        children: the processes by role. If an agent shares a process, its role has that process.
        notes: of the run. The error repeats those about the agent that ended, and names other agents with the same.
        at: the time in the run, in words.
        computing: returns the agent that a host was computing when it ended. 0: none, or the process is no host.
    """
    if any(e.code == FORKSERVER_LOST for e in exits) and (death := forkserver_death(_REAPED_S)) is not None:
        return RunBroken(f"{death} at {at}; every process of the run ended with it")
    # The world hosts the router: when it ends, others may lose their session and end as well.
    first, *others = sorted(exits, key=lambda e: (e.role != WORLD, e.code >= 0, e.role))
    child = children[first.role]
    culprit = computing(first.role)
    reason = f"{first.role.replace('-', ' ')} ({_where(first.role, child)}) {describe_exit(first.code)} at {at}"
    reason += f" while agent {culprit} computed" if culprit else ""
    about = [note for note in notes if f"agent {culprit or first.role.removeprefix('agent-')}:" in note]
    alike = {text_without_agent(note) for note in about}
    lines = fold_notes([*about, *(note for note in notes if note not in about and text_without_agent(note) in alike)])
    tail = child.tail()
    # A traceback ends in what the note says.
    if about and any(line.lstrip().startswith(("Traceback ", 'File "')) for line in tail):
        lines.append(f"the traceback is in {child.log_path}")
    else:
        lines.append(f"last lines of {child.log_path}:")
        lines += [f"  {line}" for line in tail or ["(nothing printed)"]]
    if others:
        named = ", ".join(f"{e.role} ({describe_exit(e.code)})" for e in others[:MOST_NAMED])
        lines.append("also ended: " + named + _more(len(others)))
    return RunBroken(reason, lines)


def who_waits(
    world: Mapping[str, Any],
    network: Mapping[str, Any],
    children: Mapping[str, Child],
    external: Collection[int],
    *,
    log_is_behind: bool,
    computing: Callable[[str], int] = lambda _: 0,
) -> str:
    """The agents or processes that have not answered, in words. `world` and `network` are their answers to `waiting`,
    empty without one; `external` are vehicles without a child process. `log_is_behind`: the journal has received more
    than the log holds. The rest is as for `explain`.
    """
    if not world:
        return "waiting for the world" + _condition(WORLD, children[WORLD])
    if not network:
        return "waiting for netem" + _condition(NETEM, children[NETEM])
    late = sorted({i for i, _ in world.get("waiting", ())})
    if missing := network.get("missing"):
        # The rest wait for an inbox, which waits for these.
        late = [i for i in missing if i in late] or late
    if not late:
        return "waiting for the log" if log_is_behind else "waiting"
    # On a host only the agent that computes is late; the others wait for it.
    busy = {host: computing(host) for i in late if i not in external and (host := children[agent_role(i)].role)}
    late = [i for i in late if i in external or busy[children[agent_role(i)].role] in (0, i)] or late
    named = [
        f"agent {i}" + (" (external)" if i in external else _condition(agent_role(i), children[agent_role(i)]))
        for i in late[:MOST_NAMED]
    ]
    return "waiting for " + ", ".join(named) + _more(len(late))


def _more(total: int) -> str:
    return f" and {total - MOST_NAMED} more" if total > MOST_NAMED else ""


def _where(role: str, child: Child) -> str:
    return f"pid {child.pid}" if child.role == role else f"{child.role}, pid {child.pid}"


def _condition(role: str, child: Child) -> str:
    """Words on a process that cannot answer, so that a forgotten SIGSTOP is seen at once; mostly none, or the host."""
    where = _where(role, child)
    if has_ended(child.pid):  # the process ended, and its exit has not been reported
        return f" ({where} has ended; {forkserver_suspended() or 'it has not been reaped yet'})"
    if is_suspended(child.pid):
        return f" ({where} is suspended)"
    return "" if child.role == role else f" ({where})"
