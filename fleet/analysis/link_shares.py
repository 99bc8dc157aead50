"""Links with a condition that changes by itself: their loss in the long run, and the share of time of each state."""

from __future__ import annotations

from collections.abc import Iterator

from fleet.scenario.scenario import Scenario
from netem.condition import Link
from netem.correlation import lost_share
from netem.link_states import LinkStates
from netem.link_trace import LinkTrace

_AFTER = "after its last row the link is down. With loop: true the trace begins again"


def effective_loss(changing: LinkStates | LinkTrace) -> float:
    """The share of packets that a link loses in the long run, but for its queue."""
    shares = changing.shares if isinstance(changing, LinkStates) else changing.shares()
    return sum(share * lost_share(c) for share, c in zip(shares, changing.conditions, strict=True))


def link_lines(scenario: Scenario) -> list[str]:
    """A line for each selector whose links have states or a trace."""
    return [f"links {selector}: {_words(changing)}" for selector, changing, _ in changing_links(scenario)]


def changing_links(scenario: Scenario) -> Iterator[tuple[str, LinkStates | LinkTrace, list[Link]]]:
    """Each selector of links that change by themselves, a description of the change, and these links in order."""
    by_selector: dict[str, list[Link]] = {}
    for link in scenario.changing:
        by_selector.setdefault(scenario.selectors[link], []).append(link)
    for selector, links in by_selector.items():
        yield selector, scenario.changing[links[0]], links


def short_traces(scenario: Scenario) -> Iterator[str]:
    """A sentence for each trace that ends before the run."""
    for selector, changing, _ in changing_links(scenario):
        if isinstance(changing, LinkStates) or changing.loop:
            continue
        if changing.by_packet:
            if len(changing.conditions) < (rounds := -(-scenario.ticks // scenario.round_ticks)):
                rows = len(changing.conditions)
                yield f"the trace of {selector} has {rows} rows for {rounds} rounds: {_AFTER}"
        elif changing.period_ns < scenario.duration_ns:
            ends, lasts = changing.period_ns / 1e9, scenario.duration_ns / 1e9
            yield f"the trace of {selector} ends after {ends:g} s of {lasts:g} s: {_AFTER}"


def _words(changing: LinkStates | LinkTrace) -> str:
    loss = f"effective loss {100 * effective_loss(changing):.3g} %"
    if isinstance(changing, LinkTrace):
        span = "by packet" if changing.by_packet else f"by time, {changing.period_ns / 1e9:.6g} s"
        return f"a trace of {len(changing.conditions)} rows, {span}{', in a loop' if changing.loop else ''}; {loss}"
    named = zip(changing.names, changing.shares, changing.mean_ns, strict=True)
    states = ", ".join(f"{name} {100 * share:.3g} % (mean {mean / 1e9:g} s)" for name, share, mean in named)
    return f"{states} of the time{', all links together' if changing.shared else ''}; {loss}"
