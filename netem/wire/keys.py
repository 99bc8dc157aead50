"""Zenoh key expressions of one run: all of them begin with the prefix of the run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys below `fleet/{run}`.

    `i` is a vehicle number, or the role of a process that hosts several agents, such as `host-2`. `role` is the name of
    a process, such as `world` or `agent-3`. "*" stands for all of them.
    """

    run: str

    @property
    def prefix(self) -> str:
        return f"fleet/{self.run}"

    def nav(self, i: int | str) -> str:
        """World to agent i: the measured pose and velocity of its vehicle."""
        return f"fleet/{self.run}/nav/{i}"

    def cmd(self, i: int | str) -> str:
        """Agent i to world: the command for its vehicle."""
        return f"fleet/{self.run}/cmd/{i}"

    def tx(self, i: int | str) -> str:
        """Agent i to netem: the payloads that it sends to its neighbours."""
        return f"fleet/{self.run}/tx/{i}"

    def rx(self, i: int | str) -> str:
        """Netem to agent i: the payloads that will be delivered to it."""
        return f"fleet/{self.run}/rx/{i}"

    def host(self, h: int | str) -> str:
        """World and netem to host h: navs and inboxes of the agents that share its process."""
        return f"fleet/{self.run}/host/{h}"

    def every(self, i: int) -> str:
        """All keys that end with the number of vehicle i."""
        return f"fleet/{self.run}/*/{i}"

    def cfg(self, i: int | str) -> str:
        """Query of agent i to the console: its own part of the scenario."""
        return f"fleet/{self.run}/cfg/{i}"

    def note(self, role: str) -> str:
        """Any process to console: a line of text for the operator."""
        return f"fleet/{self.run}/note/{role}"

    def alive(self, role: str) -> str:
        """The liveliness token that a process holds while it runs."""
        return f"fleet/{self.run}/alive/{role}"

    def ctl(self, role: str) -> str:
        """Query of the console to world or netem: a control request; the reply acknowledges it."""
        return f"fleet/{self.run}/ctl/{role}"

    @property
    def grant(self) -> str:
        """Console to world: the limit of its ticks, and changes of agents and faults.

        It is below `cmd`, so that the world receives grants and the agents' commands in one channel.
        """
        return f"fleet/{self.run}/cmd/grant"

    @property
    def round(self) -> str:
        """World to netem: a round begins, with the vehicles alive and their positions.

        It is below `tx`, so that netem receives rounds and the agents' transmissions in one channel.
        """
        return f"fleet/{self.run}/tx/round"

    @property
    def frame(self) -> str:
        """World to console: the state of all vehicles at each tick."""
        return f"fleet/{self.run}/frame"

    @property
    def links(self) -> str:
        """Netem to console: the final fates of the packets."""
        return f"fleet/{self.run}/links"

    @property
    def op(self) -> str:
        """Prefix of the queries of operator tools to the console: `op/{operation}`."""
        return f"fleet/{self.run}/op"

    def log(self, topic: str) -> str:
        """The messages of one topic, the same as in the log, published during a run or a replay."""
        return f"fleet/{self.run}/log/{topic}"

    def schema(self, name: str) -> str:
        """Query: the protobuf descriptor set of the messages with this schema name."""
        return f"fleet/{self.run}/schema/{name}"

    @property
    def topics(self) -> str:
        """Query: the topics below `log`, a MessagePack map from each to the name of its schema."""
        return f"fleet/{self.run}/topics"

    @property
    def units(self) -> str:
        """Query: a MessagePack map from the name of each schema to JSON, which maps its fields to [unit, meaning]."""
        return f"fleet/{self.run}/units"

    @property
    def scenario(self) -> str:
        """Query: the scenario of a live run that is published, as YAML."""
        return f"fleet/{self.run}/scenario"

    @property
    def log_end(self) -> str:
        """Put once by the publisher of a live run, after the last message: how many messages each topic had."""
        return f"fleet/{self.run}/log-end"


def tail(key: str) -> str:
    """The last two parts of a key: `tx/3` of `fleet/{run}/tx/3`, but `{run}/links` of `fleet/{run}/links`."""
    return "/".join(key.rsplit("/", 2)[-2:])


def vehicle_of(key: str) -> int:
    """The vehicle number that is the last part of a key; 0 if the last part is no number."""
    last = key.rsplit("/", 1)[-1]
    return int(last) if last.isdigit() else 0
