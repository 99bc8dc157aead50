"""`fleet record --ros2`: what nodes of ROS 2 publish on one domain, into a bag, as it comes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fleet.addons.robots.ros2.bag import NewBag
from fleet.addons.robots.ros2.rmw import DEFAULT, Entity, read_key, unpack
from fleet.addons.robots.ros2.types import NO_HASH, RosTypes
from fleet.replay.capture import FLUSH_NS
from netem.wire.open_bus import ZenohSample
from netem.wire.ros_bus import RosBus

MOST_TOPICS = 65_535  # MCAP numbers them with 16 bits
MOST_SAID = 100


class WithHistory:
    """Subscribes to new messages, and to those that publishers keep for late subscribers, such as /tf_static."""

    def __init__(self, bus: RosBus) -> None:
        self._bus = bus

    def subscribe(self, key: str, handler: Callable[[Any], None]) -> Callable[[], None]:
        return self._bus.subscribe_with_history(key, handler)


class BagWriter:
    """Writes samples of rmw_zenoh as messages of a bag; see `fleet.replay.capture.SampleWriter`."""

    def __init__(self, folder: Path, types: RosTypes, tell: Callable[[str], None]) -> None:
        """Make the bag. `tell`: called with a line about each topic that cannot be recorded. Raises FleetError: there
        is something at that place, or it cannot be made."""
        self.path, self.samples = folder, 0
        self._types, self._tell = types, tell
        self._bag = NewBag(folder, types)
        self._topics: dict[str, Entity | None] = {}  # by key; None: it is left out
        self._names: set[str] = set()
        self._said: set[str] = set()
        self.size = 0
        self._flushed_ns = 0
        self._open = True

    def add(self, sample: ZenohSample, at_ns: int) -> None:
        """Append a sample that was received at `at_ns` [ns since 1970]. Raises FleetError: the disk is full."""
        if sample.key not in self._topics:
            self._topics[sample.key] = self._topic(sample)
        entity = self._topics[sample.key]
        if entity is None or sample.delete:
            return
        try:
            unpack(sample.attachment)
            self._types.decode(entity.type, sample.payload)
        except ValueError as error:
            self._say(f"warning: a message was left out, {entity.name}: {error}")
            return
        self._bag.write(entity.name, at_ns, sample.payload)
        self.samples += 1
        self.size += len(sample.payload)
        self.flush(at_ns)

    def flush(self, now_ns: int) -> None:
        """Write out what there is if a second has passed since the last time. Raises FleetError: the disk is full."""
        if now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            self._bag.flush()

    def close(self) -> None:
        """Write the index, once. Raises FleetError: the disk is full."""
        if self._open:
            self._open = False
            self._bag.close()

    def _topic(self, sample: ZenohSample) -> Entity | None:
        entity = read_key(sample.key)
        if problem := f"{sample.key} is no key of rmw_zenoh" if entity is None else self._problem(entity):
            self._say(f"left out: {problem[:200]}; fleet record --key records any bytes")
            return None
        assert entity is not None
        self._names.add(entity.name)
        self._bag.topic(entity.name, entity.type, DEFAULT)
        return entity

    def _problem(self, entity: Entity) -> str:
        if entity.type not in self._types.store.fielddefs:
            return f"{entity.name}: the type {entity.type} is not known here"
        if entity.hash not in (self._types.hash(entity.type), NO_HASH):
            return f"{entity.name}: another version of {entity.type} than that of {self._types.distribution}"
        if entity.name in self._names:
            return f"{entity.name}: a second type or version, {entity.type} {entity.hash:.16}"
        return f"{entity.name}: more than {MOST_TOPICS} topics" if len(self._names) >= MOST_TOPICS else ""

    def _say(self, text: str) -> None:
        if text not in self._said and len(self._said) < MOST_SAID:
            self._said.add(text)
            self._tell(text)
