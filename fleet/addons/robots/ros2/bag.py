"""Bags of ROS 2: a directory with an MCAP file of CDR messages and metadata.yaml, as `ros2 bag` reads it."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from fleet.addons.page.feed import checks_judged
from fleet.addons.robots.ros2.rmw import DEFAULT, Qos
from fleet.addons.robots.ros2.translation import RosMessage, Translation
from fleet.addons.robots.ros2.types import RosTypes, types_of
from fleet.errors import FleetError
from fleet.mcap.other import Recovered
from fleet.mcap.reader import LogReader, OnProgress
from fleet.mcap.recover import recover
from fleet.replay.capture import writing
from netem.private_folder import PrivateFolder


def bag_file(folder: Path) -> Path | None:
    """The MCAP file of a bag that is a directory; None: it is no bag."""
    file = folder / f"{folder.resolve().name}.mcap"
    return file if folder.is_dir() and file.is_file() else None


def repair(folder: Path, out: Path | None = None, on_progress: OnProgress = lambda _: None) -> Recovered:
    """Write what can be read of a bag to `out`, by default `<bag>.recovered` beside it; nothing if nothing can. Raises
    LogReadError: the MCAP file cannot be opened; FleetError: `out` exists or cannot be written; the bag has a topic of
    a type that is not known here."""
    file = bag_file(folder)
    assert file is not None
    out = out or folder.with_name(f"{folder.resolve().name}.recovered")
    if out.exists():
        raise FleetError(f"{out} exists already: choose another place with -o OUT")
    try:
        with PrivateFolder("bag", out.parent) as private:
            whole = private / "whole.mcap"
            found = recover(file, whole, on_progress)
            found.path, found.out = folder, out
            if not found.nothing:
                _write(LogReader(whole), out)
    except OSError as error:
        raise FleetError(f"cannot write {out}: {error.strerror or error}") from error
    return found


def _write(reader: LogReader, out: Path) -> None:
    bag = NewBag(out, types_of())
    try:
        known: set[str] = set()
        for record in reader:
            if record.topic not in known:
                known.add(record.topic)
                schema = next(c.schema_id for c in reader.channels.values() if c.topic == record.topic)
                bag.topic(record.topic, reader.schemas[schema].name, DEFAULT)
            bag.write(record.topic, record.log_ns, record.data)
        bag.close()
    except BaseException:
        bag.abandon()
        raise


_FORMAT = 9  # of metadata.yaml: Iron and later; they read it, and Humble reads the MCAP file alone


class NewBag:
    """A bag that is written. `close` writes its index; `abandon` removes it."""

    def __init__(self, folder: Path, types: RosTypes) -> None:
        """Make the directory. Raises FleetError: there is something at that place, or it cannot be made."""
        from rosbags.rosbag2 import StoragePlugin, Writer

        self.folder, self._types = folder, types
        self.messages = 0
        self._connections: dict[str, Any] = {}
        if folder.exists():
            raise FleetError(f"{folder} exists already; a bag is a new directory")
        self._writer = Writer(folder, version=_FORMAT, storage_plugin=StoragePlugin.MCAP)
        with writing(self.folder):
            self._writer.open()

    def topic(self, name: str, type_name: str, qos: Qos) -> None:
        """Add a topic to the bag. `qos`: that its publisher offers. Raises FleetError: the type is not known."""
        if type_name not in self._types.store.fielddefs:
            raise FleetError(f"{name}: the type {type_name} is not known")
        self._connections[name] = self._writer.add_connection(
            name,
            type_name,
            msgdef=self._types.definition(type_name),
            rihs01=self._types.hash(type_name),
            offered_qos_profiles=[_profile(qos)],
        )

    def write(self, topic: str, at_ns: int, data: bytes) -> None:
        """Append a message in CDR at a time [ns]. Raises FleetError: the disk is full."""
        with writing(self.folder):
            self._writer.write(self._connections[topic], at_ns, data)
        self.messages += 1

    def add(self, message: RosMessage) -> None:
        """Append a message. If the bag does not have its topic yet, add the topic first. Raises FleetError: the type of
        the message is not known, or the bag cannot be written (the disk is full)."""
        if message.name not in self._connections:
            self.topic(message.name, message.topic.type, message.topic.qos)
        self.write(message.name, message.at_ns, self._types.encode(message.topic.type, message.message))

    def flush(self) -> None:
        """Write all messages to the disk. They can then be recovered from a bag that nobody closed. Raises FleetError:
        the bag cannot be written (the disk is full)."""
        storage: Any = self._writer.storage
        with writing(self.folder):
            if storage.chunk.bio.tell():
                storage.close_chunk()
            storage.bio.flush()

    def close(self) -> None:
        """Write the index and metadata.yaml. Raises FleetError: the disk is full."""
        with writing(self.folder):
            self._writer.close()

    def abandon(self) -> None:
        with suppress(Exception):
            self._writer.abort()
        shutil.rmtree(self.folder, ignore_errors=True)


def write_bag(log: Path, folder: Path, share: OnProgress = lambda _: None) -> tuple[list[Path], str]:
    """Write a log as a bag; times are simulated time from 0. Returns the files, and what was missing in the log, or "".
    Raises FleetError: it has nothing for ROS, or the place is taken or cannot be written; LogReadError: there is no log
    to read."""
    types = types_of()
    reader = LogReader(log, share)
    bag: NewBag | None = None
    try:
        translation = Translation(types, {})
        known = 0
        for record in reader:
            if len(reader.channels) != known:  # they are declared on the way
                known = len(reader.channels)
                translation.learn({c.topic: reader.schemas.get(c.schema_id) for c in reader.channels.values()})
            for message in translation(record.topic, record.log_ns, record.data):
                bag = bag or NewBag(folder, types)
                bag.add(message)
        if bag is None:
            raise FleetError(f"{log} holds nothing that has a topic in ROS 2: it is no log of a run")
        judged = checks_judged(log)
        if judged is not None and translation.diagnostics.checks(judged["rows"]):
            bag.add(translation.diagnostics_message(reader.last_ns))
        bag.close()
    except BaseException:
        if bag is not None:
            bag.abandon()
        raise
    return sorted(folder.iterdir()), reader.missing


def _profile(qos: Qos) -> Any:
    from rosbags.interfaces import Qos as Profile
    from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(0, 0)
    return Profile(
        QosHistory.KEEP_LAST,
        qos.depth,
        QosReliability.BEST_EFFORT if qos.best_effort else QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if qos.transient_local else QosDurability.VOLATILE,
        never,
        never,
        QosLiveliness.AUTOMATIC,
        never,
        avoid_ros_namespace_conventions=False,
    )
