"""A run of `fleet netem`, and the sessions that programs of robots open."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import zenoh
from free_ports import free_port
from live import READY_S, LiveRun
from tool import invoke
from waiting import wait_for

from fleet.result.file import read_result
from fleet.result.result import Result


class Stack(LiveRun):
    """`fleet netem` on free ports; each node that says nothing else has a router of its own."""

    def __init__(self, folder: Path, *options: str, nodes: Mapping[str, Any], **sections: Any) -> None:
        self.ports: dict[str, int] = {}
        for name, node in nodes.items():
            if node is None:
                self.ports[name] = free_port()
        own = {name: {"listen": f"tcp/127.0.0.1:{port}"} for name, port in self.ports.items()}
        sections = {"checks": {"punctual": {"late": "1 min"}}} | sections  # whatever else the machine does
        file = folder / "stack.yaml"
        file.write_text(json.dumps({"title": "A stack", "nodes": {**nodes, **own}, **sections}), "utf-8")
        super().__init__(folder / "runs", str(file), *options, verb="netem")
        self.file = file

    def begun(self) -> Stack:
        """Wait until its nodes can be reached."""
        # Written once the sessions of the nodes are open; the log would say so a second later.
        wait_for(lambda: self.over or (self.out / "latest" / "connection.json").exists(), READY_S, "its nodes")
        assert not self.over, self.printed
        self.family()
        return self

    def fleet(self, *words: str) -> str:
        """The output of a command for this run, as from another terminal, but without starting Python."""
        done = invoke(*words, "--run", self.directory)
        assert done.exit_code == 0, done.output
        return done.stdout

    def end(self, status: int = 0) -> Result:
        """Stop it, and return its result."""
        if not self.over:
            self.fleet("stop")
        self.ends(status)
        return read_result(self.directory)

    @contextmanager
    def program(self, node: str) -> Iterator[Any]:
        """A session of a program of a robot: zenoh with nothing of ours."""
        with closing(program(self.ports[node])) as session:
            yield session


def program(port: int, settings: Mapping[str, Any] = MappingProxyType({})) -> Any:
    config = zenoh.Config()
    own = {"mode": "client", "connect/endpoints": [f"tcp/127.0.0.1:{port}"], "scouting/multicast/enabled": False}
    for key, value in (own | settings).items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
