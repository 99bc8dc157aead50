"""Key expressions of one run. One run is one prefix; nothing of ours lives outside it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys below `fleet/{run}`; `i` is a vehicle number."""

    run: str

    @property
    def prefix(self) -> str:
        return f"fleet/{self.run}"

    def nav(self, i: int | str) -> str:
        """World to agent i."""
        return f"fleet/{self.run}/nav/{i}"

    def cmd(self, i: int | str) -> str:
        """Agent i to world."""
        return f"fleet/{self.run}/cmd/{i}"

    def tx(self, i: int | str) -> str:
        """Agent i to netem."""
        return f"fleet/{self.run}/tx/{i}"

    def rx(self, i: int | str) -> str:
        """Netem to agent i."""
        return f"fleet/{self.run}/rx/{i}"

    def cfg(self, i: int | str) -> str:
        """Agent i asks the console for its slice of the scenario (query)."""
        return f"fleet/{self.run}/cfg/{i}"

    def note(self, role: str) -> str:
        """Any process to console: a line for the operator."""
        return f"fleet/{self.run}/note/{role}"

    def alive(self, role: str) -> str:
        """Liveliness token of a process."""
        return f"fleet/{self.run}/alive/{role}"

    def ctl(self, role: str) -> str:
        """Console to world or netem (query: acknowledged)."""
        return f"fleet/{self.run}/ctl/{role}"

    @property
    def grant(self) -> str:
        """Console to world; below `cmd`, so that one channel of the world holds all that moves it."""
        return f"fleet/{self.run}/cmd/grant"

    @property
    def round(self) -> str:
        """World to netem."""
        return f"fleet/{self.run}/round"

    @property
    def frame(self) -> str:
        """World to console."""
        return f"fleet/{self.run}/frame"

    @property
    def links(self) -> str:
        """Netem to console."""
        return f"fleet/{self.run}/links"

    @property
    def op(self) -> str:
        """Operator tools to console (query)."""
        return f"fleet/{self.run}/op"

    def log(self, topic: str) -> str:
        """The journal, topic for topic what the log holds."""
        return f"fleet/{self.run}/log/{topic}"

    def schema(self, name: str) -> str:
        """The protobuf descriptor set of a log message (query)."""
        return f"fleet/{self.run}/schema/{name}"

    @property
    def clock(self) -> str:
        """The time of a replay, as a source of time for others."""
        return f"fleet/{self.run}/clock"


def tail(key: str) -> str:
    """The key without the run: `tx/3`."""
    return "/".join(key.rsplit("/", 2)[-2:])


def vehicle_of(key: str) -> int:
    """The vehicle number at the end of a key; 0 when there is none."""
    last = key.rsplit("/", 1)[-1]
    return int(last) if last.isdigit() else 0
