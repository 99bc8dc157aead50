"""The agents behind the addresses that programs know."""

from __future__ import annotations

from collections.abc import Mapping
from ipaddress import IPv6Address, ip_address

from agents.api import AgentConfig
from agents.packets import EVERYBODY, V4

_HOSTS = 254  # nodes that have a name, unless a neighbour has a larger number


class AddressBook:
    """The agents behind addresses."""

    def __init__(self, config: AgentConfig, given: Mapping[str, int]) -> None:
        self.own, self._given = config.id, dict(given)
        self.largest = max([_HOSTS, config.id, *(each.id for each in config.neighbours), *self._given.values()])

    @property
    def has_others(self) -> bool:
        """Whether it names addresses outside of the nodes' network."""
        return any(not key.startswith(("127.", "localhost", "10.0.")) for key in self._given)

    def agent(self, ip: bytes, port: int) -> int | None:
        """The agent at an address; `EVERYBODY`: all; None: nobody."""
        v4 = ip[:12] == V4
        if self._given:
            text = str(ip_address(ip[12:]) if v4 else IPv6Address(ip))
            for key in (f"{text}:{port}", text, f"localhost:{port}" if text.startswith("127.") else text):
                if key in self._given:
                    return self._given[key]
        if v4:
            a, b, c, d = ip[12:]
            if (
                a >> 4 == 14
                or ip[12:] == b"\xff\xff\xff\xff"
                or (a == 10 and b == 0 and d == 255 and (c == 0 or c == 255))
            ):
                return EVERYBODY
            if a == 127:
                return self.own
            return c << 8 | d if (a, b) == (10, 0) else None
        if ip[0] == 255:
            return EVERYBODY
        if ip == bytes(15) + b"\x01":
            return self.own
        return ip[14] << 8 | ip[15] if ip[0] == 0xFD or ip[:2] == b"\xfe\x80" else None
