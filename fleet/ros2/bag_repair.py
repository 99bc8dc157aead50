"""`fleet recover BAG`: what is left of a bag of ROS 2 whose recorder was killed, as a new bag with metadata.yaml."""

from __future__ import annotations

from pathlib import Path

from fleet.errors import FleetError
from fleet.logs.reader import LogReader, Tell
from fleet.logs.recover import Recovered, recover
from fleet.ros2.bag import Bag
from fleet.ros2.rmw import DEFAULT
from fleet.ros2.types import types_of


def bag_file(folder: Path) -> Path | None:
    """The MCAP file of a bag that is a directory; None: it is no bag."""
    file = folder / f"{folder.resolve().name}.mcap"
    return file if folder.is_dir() and file.is_file() else None


def repair(folder: Path, out: Path | None = None, tell: Tell = lambda _: None) -> Recovered:
    """Write what can be read of a bag to `out`, by default `<bag>.recovered` beside it; nothing if nothing can.

    Raises:
        LogReadError: the MCAP file cannot be opened.
        FleetError: `out` exists or cannot be written; the bag has a topic of a type that is not known here.
    """
    file = bag_file(folder)
    assert file is not None
    out = out or folder.with_name(f"{folder.resolve().name}.recovered")
    if out.exists():
        raise FleetError(f"{out} exists already: choose another place with -o OUT")
    whole = out.with_name(f"{out.name}.part.mcap")
    whole.unlink(missing_ok=True)
    try:
        found = recover(file, whole, tell)
        found.path, found.out = folder, out
        if not found.nothing:
            _write(LogReader(whole), out)
    finally:
        whole.unlink(missing_ok=True)
    return found


def _write(reader: LogReader, out: Path) -> None:
    bag = Bag(out, types_of())
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
