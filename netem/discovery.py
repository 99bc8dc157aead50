"""Discovery between robots: each liveliness token of a program is shown to the robots that its links reach."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from time import monotonic_ns

from netem.condition import Link
from netem.limits import TOKENS
from netem.relay import Relay
from netem.wire.robots import Robot, Token


class Discovery:
    """The tokens of all robots, and where each is shown."""

    def __init__(
        self,
        robots: Mapping[int, Robot],
        hearers: Mapping[int, set[int]],
        relay: Callable[[], Relay],
        note: Callable[[str], None],
        *,
        linked: bool,
        lost_after_ns: int,
    ) -> None:
        """Begin without tokens.

        Args:
            robots: by number.
            hearers: by robot, those that get its tokens.
            relay: gives the relay of now, which says which links pass something, and how late.
            note: takes a line for the operator.
            linked: a token appears after the delay of its link, and disappears when nothing can pass the link.
            lost_after_ns: for how long nothing may pass before a token disappears.
        """
        self._robots, self._hearers, self._relay, self._note = robots, hearers, relay, note
        self._linked, self._lost_after_ns = linked, lost_after_ns
        self._tokens: dict[str, set[int]] = {}  # by key: the robots that have it
        self._coming: dict[Link, dict[str, int]] = {}  # when a token is to appear at the end of a link [ns]
        self._shown: dict[Link, set[str]] = {link: set() for link in relay().config.links}
        self._passed_ns: dict[Link, int] = {}  # when something could pass a link last

    def announce(self, token: Token) -> None:
        """Take a token that a robot's program has made or taken back."""
        robot, key = self._robots[token.robot], token.key
        if not robot.carries(key):
            return
        links = [(token.robot, dst) for dst in self._hearers.get(token.robot, ())]
        holders = self._tokens.get(key, set())
        if not token.alive:
            if token.robot in holders:
                holders.remove(token.robot)
                if not holders:
                    del self._tokens[key]
                for link in links:
                    self._coming.get(link, {}).pop(key, None)
                    self._hide(link, key)
            return
        if token.robot in holders:
            return
        if len(self._tokens) >= TOKENS.items:
            self._note(f"{robot.name}: more than {TOKENS.items} liveliness tokens; others do not see the rest")
            return
        self._tokens.setdefault(key, holders).add(token.robot)
        for link in links:
            if self._linked:
                self._coming.setdefault(link, {})[key] = monotonic_ns() + self._relay().latency_ns(link)
            else:
                self._show(link, key)

    def update(self, now_ns: int) -> None:
        """With `linked`, show the tokens that are due, and hide those behind a link that nothing passes for long."""
        for link in self._relay().config.links if self._linked else ():
            coming = self._coming.setdefault(link, {})
            if self._relay().passes(link, now_ns):
                self._passed_ns[link] = now_ns
                for key in [key for key, at_ns in coming.items() if at_ns <= now_ns]:
                    del coming[key]
                    self._show(link, key)
            elif now_ns - self._passed_ns.setdefault(link, now_ns) > self._lost_after_ns:
                for key in [*self._shown[link]]:
                    self._hide(link, key)
                    coming[key] = now_ns

    def _show(self, link: Link, key: str) -> None:
        self._shown[link].add(key)
        robot = self._robots[link[1]]
        robot.outlet.do(partial(robot.mirror, key))

    def _hide(self, link: Link, key: str) -> None:
        """A token is no longer shown at the end of a link, unless another robot has it and reaches there, too."""
        if key not in self._shown[link]:
            return
        self._shown[link].remove(key)
        if not any(key in self._shown.get((src, link[1]), ()) for src in self._tokens.get(key, ())):
            robot = self._robots[link[1]]
            robot.outlet.do(partial(robot.withdraw, key))
