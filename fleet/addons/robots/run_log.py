"""The journal of a live run as a log: its topics, schemas, times and scenario are those of the run's own log."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from fleet.errors import FleetError
from fleet.recorder.log_file import LogFile
from fleet.recorder.writer import run_metadata, scenario_metadata
from fleet.replay.capture import FLUSH_NS
from fleet.replay.topics import ask_scenario, ask_topics, unpack
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from netem.wire.keys import Keys
from netem.wire.open_bus import OpenBus, ZenohSample
from world.errors import PluginError


class RunLogWriter:
    """Writes the samples of a journal as the messages that they were. `close` writes the index."""

    def __init__(self, path: Path, bus: OpenBus, keys: Keys) -> None:
        """Ask the run for its topics and its scenario. Raises FleetError: the file exists or cannot be made, or nobody
        answers.
        """
        if path.exists():
            raise FleetError(f"{path} exists already; choose another name with -o")
        topics = ask_topics(bus, keys)
        text = ask_scenario(bus, keys)
        self.samples = 0
        self.foreign = 0  # samples that are no messages of the journal
        self._prefix = keys.log("")
        self._first = self._last = -1  # places in the run's log
        self._flushed_ns = 0
        self._log = LogFile(path)
        self._log.attachment("scenario.yaml", "application/yaml", text.encode())
        self._log.metadata("run", _facts(parse_scenario(text, str(path))))
        self._channels = {
            topic: self._log.other_channel(
                topic, "protobuf", (known.schema, "protobuf", known.descriptor_set), {"units": known.units}
            )
            for topic, known in topics.items()
        }

    @property
    def size(self) -> int:
        return self._log.size

    def add(self, sample: ZenohSample, at_ns: int) -> None:
        """Append a message. `at_ns`: when it came [ns since 1970]. Raises LogError: it cannot be written."""
        channel = self._channels.get(sample.key.removeprefix(self._prefix))
        stamp = None
        with suppress(ValueError):
            stamp = unpack(sample.attachment or b"")
        if channel is None or stamp is None:
            self.foreign += 1
            return
        self._log.message(channel, stamp.log_ns, stamp.publish_ns, stamp.sequence & 0xFFFFFFFF, sample.payload)
        self._first = stamp.number if self._first < 0 else min(self._first, stamp.number)
        self._last = max(self._last, stamp.number)
        self.samples += 1
        self.flush(at_ns)

    def flush(self, now_ns: int) -> None:
        """Write out what there is if a second has passed since the last time. Raises LogError."""
        if now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            self._log.flush(now_ns)

    def close(self) -> None:
        """Write the index. Raises LogError: it cannot be written."""
        self._log.close()

    @property
    def lacks(self) -> str:
        """What of the run is not in the file, in words; empty: nothing up to the last message."""
        parts = {
            "before the recorder came": max(self._first, 0),
            "on the way": self._last - self._first + 1 - self.samples,
        }
        words = [f"{count} {where}" for where, count in parts.items() if self.samples and count > 0]
        return f"messages of the run that are missing: {', '.join(words)}" if words else ""


def _facts(scenario: Scenario) -> dict[str, str]:
    """The metadata of a log; without what determines laws that may not be loaded here."""
    try:
        return run_metadata(scenario)
    except PluginError:
        return scenario_metadata(scenario)
