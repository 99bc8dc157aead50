"""How much is read of each kind of input that somebody else may have written.

One table, because a reader of a new kind of file needs to see what the others take, and because the page on limits
prints it. Limits of what we draw, print or search are not among them; these stand where they act.
"""

from __future__ import annotations

from typing import NamedTuple


class Limit(NamedTuple):
    """What is read of one kind of input; 0 where nothing is limited but by the rest."""

    what: str
    bytes: int = 0
    items: int = 0
    counted: str = ""  # what `items` is the number of
    depth: int = 0  # how many things may lie within each other


# After aliases: ten lines of aliases to aliases can stand for 10^10 values.
SCENARIO = Limit("scenario, stack file or study (YAML)", 4_000_000, 20_000, "values", 30)
SCENARIO_CHARACTERS = 1_000_000
TRACE = Limit("trace of a link (CSV)", 10_000_000, 100_000, "rows")
DATA_FILE = Limit("modem, grade or other table beside a scenario", 100_000)
# The scenario of a log holds the trace, and has at most a million characters.
NAVIGATION_TRACE = Limit("trace of navigation", 400_000)

LOG_RECORD = Limit("record of a log, packed or not", 64 << 20, 65_536, "messages of a chunk")
LOG_MESSAGE = Limit("message of a log that is decoded", 8 << 20, 100_000, "values shown one by one")
LOG_REST = Limit("attachments, schemas, channels and metadata of a log", 256 << 20, 65_536, "channels")
LOG_FAULTS = Limit("messages about faults of a log", 64 << 20, 200_000, "messages")
RESULT_FILE = Limit("result.json", 20_000_000)

STUDY_RECORD = Limit("study.json", 32_000_000, 1000, "axes, checks or columns")  # bytes: of a million seeds
STUDY_ROWS = Limit("rows of a study (SQLite)", 2_000_000_000)  # 3 million runs
FAILURES = Limit("failures.json of a search", 4_000_000, 10_000, "failures")
RARE = Limit("rare.json", 10_000_000)

CONNECTION_FILE = Limit("connection file or join file, with certificates", 1_000_000)
CREDENTIALS = Limit("certificate, key or credentials of hosts", 1_000_000)
OBSERVED = Limit("observe.json of a run that publishes", 100_000)
TRUSTED = Limit("list of laws that you have run", 50_000_000, 10_000, "lines that are kept")  # a path has 4096 at most

FMU = Limit("FMU, unpacked", 1 << 30, 10_000, "files")
FMU_DESCRIPTION = Limit("modelDescription.xml", 32 << 20, 2_000_000, "elements", 64)

# Zenoh's low-latency transport cannot fragment, and loses longer messages silently. Measured: 49,120 bytes pass through
# its Unix sockets with our settings, 49,152 do not. Frames, reports and answers to queries travel in parts. A longer
# put raises an error.
WIRE_MESSAGE = Limit("message between processes of a run", 48_000)
LONGEST_DATAGRAM = Limit("datagram of a program", 65_535)
LINK_UNDER_WAY = Limit("packets under way in one link of `fleet netem`", 64 << 20, 10_000, "messages in fragments")
RELAY_WAITING = Limit("messages of one robot that wait for the relay", 64 << 20, 16_384, "messages")
ROBOT_WAITING = Limit("messages that wait for one robot", 64 << 20, 4096, "messages")
QUERIES_WAITING = Limit("queries that wait for answers", 64 << 20, 10_000, "queries of one robot")
TOKENS = Limit("liveliness tokens of one robot", 0, 10_000, "tokens")

ALL = tuple(limit for limit in globals().values() if isinstance(limit, Limit))


def table() -> str:
    """The table of the page on security."""
    rows = [f"| {one.what} | {_bytes(one.bytes)} | {_items(one)} |" for one in ALL]
    return "\n".join(["| input | most | and |", "|---|---|---|", *rows]) + "\n"


def _bytes(number: int) -> str:
    for size, unit in ((1 << 30, "GiB"), (1 << 20, "MiB"), (10**9, "GB"), (10**6, "MB"), (1000, "kB")):
        if number and number % size == 0:
            return f"{number // size} {unit}"
    return f"{number:,} bytes" if number else ""


def _items(limit: Limit) -> str:
    depth = [f"{limit.depth} deep"] if limit.depth else []
    return ", ".join([f"{limit.items:,} {limit.counted}"] * bool(limit.items) + depth)
