"""Programs as the console knows them: what a keeper says of them is made up, and none starts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from fleet.addons.robots.programs import Programs
from fleet.scenario.loading import parse_scenario
from fleet.scenario.trust import Policy

NODES = {"m1": {}, "m2": {}}
BEGIN_NS = 1000


class Known(Programs):
    """Keeps what it tells the keeper, and what it shows the operator."""

    def __init__(self, folder: Path, **sections: Any) -> None:
        text = yaml.safe_dump({"title": "x", "nodes": NODES, "duration": "5 s"} | sections, sort_keys=False)
        self.shown: list[str] = []
        scenario = parse_scenario(text, "stack.yaml", policy=Policy(stranger=""))
        super().__init__(scenario, folder, self.shown.append)
        self.told: list[dict[str, Any]] = []
        self._planned_ns = None

    def _tell(self, **values: Any) -> None:
        self.told.append(values)

    def say(self, at: int, **values: Any) -> None:
        """The keeper says that something happened at a time [ns]."""
        self._take(json.loads(json.dumps({"at": at} | values)))

    def runs(self, *names: str) -> None:
        """They were started and are ready; the run begins."""
        for name in names:
            self.say(0, started=name, pid=1)
            self.say(1, ready=name)
        self.advance(1)
        self.begin_ns = BEGIN_NS
