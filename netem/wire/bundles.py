"""Messages of agents that share a process: many in one put, because each put wakes a thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from netem.errors import MalformedMessage
from netem.wire.bus import Bus
from netem.wire.codec import encode
from netem.wire.credentials import Members, host_role
from netem.wire.keys import Keys
from netem.wire.messages import Bundle, BundlePart
from netem.wire.parts import PART_BYTES, split

_PART_BYTES = 12  # length of a part besides its message


def bundles(parts: Sequence[BundlePart]) -> Iterator[bytes]:
    """Encoded bundles of parts in their order; each bundle fits into the transport."""
    for some, _ in split(parts, _size, PART_BYTES):
        yield encode(Bundle(tuple(some)))


class AgentGroups:
    """The hosts of a run, as world and netem see them: the agents on each host, and the key that leads there."""

    def __init__(self, bus: Bus, keys: Keys, members: Members, up: Callable[[str], str]) -> None:
        """Connect. `members`: the vehicles of each host. `up`: the key that carries the messages of a host with that
        role.
        """
        numbers = range(1, len(members) + 1)
        self._of = {i: h for h, group in zip(numbers, members, strict=True) for i in group}
        self._puts = {h: bus.publisher(keys.host(h)) for h in numbers}
        self._by_key = {up(host_role(h)): h for h in numbers}

    def of(self, i: int, incarnation: int) -> int:
        """The host of a life of agent i; 0: that has a process of its own, as all but the first have."""
        return 0 if incarnation else self._of.get(i, 0)

    def number(self, key: str) -> int:
        """Whose key it is; 0: no host's."""
        return self._by_key.get(key, 0)

    def check(self, h: int, i: int) -> None:
        """Let host h speak for its own agents only. Raises MalformedMessage: agent i is not on host h."""
        if self._of.get(i) != h:
            raise MalformedMessage("bundle", f"vehicle {i} is not on {host_role(h)}")

    def greet(self, h: int, echo: bytes) -> None:
        self._puts[h](echo)

    def put(self, h: int, messages: Iterable[tuple[int, bytes]]) -> None:
        for data in bundles([BundlePart(i, message) for i, message in messages]):
            self._puts[h](data)


def _size(part: BundlePart) -> int:
    return _PART_BYTES + len(part.message)
