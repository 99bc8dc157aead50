"""Programs of nodes: how each is started, when it is ready, how it is stopped, and the signals that it tells."""

from __future__ import annotations

import re
import shlex
import struct
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from fleet.quantities import describe_value
from fleet.scenario import value_types as v
from fleet.scenario.schema.nodes import Flag
from fleet.scenario.value_types import Section, mistake
from netem.parsing import nearest

PLACEHOLDERS = (
    "listen", "zenoh", "modem", "address", "node", "number", "seed", "begin_s", "duration_s", "dir", "domain",
)  # fmt: skip
READY_WITHIN_NS, STOP_WITHIN_NS = 20_000_000_000, 5_000_000_000
_PROGRAM = re.compile(r"[\w.*?-]{1,64}(/[A-Za-z][\w.-]{0,31})?", re.ASCII)
_SIGNAL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}", re.ASCII)
_BRACED = re.compile(r"(?<!\$)\{([A-Za-z]\w*)\}", re.ASCII)
OF_KEYS = ("node", "number")  # placeholders that keys have
_FORMATS = ("json", "msgpack", "cbor", "ros", "struct")


def fill_placeholders(text: str, values: Mapping[str, object]) -> str:
    """A text with values in place of `{node}` and other placeholders; other braces stay as they are."""
    return re.sub(rf"\{{({'|'.join(PLACEHOLDERS)})\}}", lambda found: str(values.get(found[1], found[0])), text)


def no_placeholder(text: str, known: Sequence[str], likeness: float = 0.0) -> str:
    """What is wrong with the first word in braces that looks like a placeholder and is none of the known ones, or an
    empty text.

    Args:
        text: in which they are filled in.
        known: the placeholders that mean something there.
        likeness: how near it has to be to a known one. Command lines may have other braces, as those of JSON.
    """
    for word in _BRACED.findall(text):
        hint = nearest(word, known, likeness) if likeness else " and ".join(f"{{{each}}}" for each in known) + " are"
        if word not in known and hint:
            return f"{{{word}}} is no placeholder: {hint}"
    return ""


def _key(value: Any) -> Any:
    if not isinstance(value, str) or not _PROGRAM.fullmatch(value):
        hint = 'as in m1, "m*", or m1/mission for one of several programs of a robot'
        raise mistake(f"expected a node or a pattern of nodes, got {describe_value(value)}", hint=hint)
    return value


def _signal(value: Any) -> Any:
    if not isinstance(value, str) or not _SIGNAL.fullmatch(value):
        raise mistake(f"expected a name of letters, digits and _, got {describe_value(value)}", hint="as in leader")
    return value


def _words(value: Any) -> Any:
    """A command line as its words; a text is taken apart as a shell does it, and no shell runs."""
    if isinstance(value, str):
        try:
            value = shlex.split(value)
        except ValueError as error:
            raise mistake(f"cannot be taken apart into words: {error}") from None
    if not isinstance(value, list) or not value or not all(isinstance(word, str | int | float) for word in value):
        hint = 'run: [python, member.py, "{listen}"]'
        raise mistake(f"expected a command line, got {describe_value(value)}", hint=hint)
    return [str(word) for word in value]


def _pattern(value: Any) -> Any:
    if isinstance(value, str) and len(value) > _MOST_PATTERN:
        raise mistake(f"has {len(value)} characters: {_MOST_PATTERN} at most")
    try:
        re.compile(value if isinstance(value, str) else "")
    except (re.error, OverflowError, RecursionError) as error:
        raise mistake(f"is no regular expression: {error}") from None
    return value


def _texts(value: Any) -> Any:
    return {name: str(each) for name, each in value.items()} if isinstance(value, dict) else value


_STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(-?\d{1,9})\]", re.ASCII)
_STRUCT = re.compile(r"([@=<>!]?[\dcbB?hHiIlLqQnNefdspPx\s]+)(?:\[(\d{1,6})\])?", re.ASCII)
_MOST_STRUCT = 65_536  # bytes
_MOST_PATTERN = 1000  # characters


def _is_path(text: str) -> bool:
    """Whether steps follow each other without anything between. (Rejected: one expression for all steps. A stranger's
    text of thirty letters then has more ways to be steps than anybody can try.)
    """
    at = 0
    while at < len(text):
        found = _STEP.match(text, at)
        if found is None:
            return False
        at = found.end()
    return True


def path_of(text: str) -> list[str | int]:
    """The steps of a path such as `[0][2]` or `pose.position.x`; none: the whole value."""
    return [found[1] if found[1] is not None else int(found[2]) for found in _STEP.finditer(text)]


def struct_of(text: str) -> tuple[struct.Struct, int] | None:
    """The layout of bytes in `<Hf[1]`, and which number of it is meant; None: it is no layout with such a number."""
    found = _STRUCT.fullmatch(text)
    try:
        layout = struct.Struct(found[1]) if found is not None else None
    except struct.error:
        return None
    if found is None or layout is None or not 0 < layout.size <= _MOST_STRUCT:
        return None
    which = int(found[2] or 0)
    numbers = len(layout.unpack(bytes(layout.size)))
    return (layout, which) if which < numbers else None


def _path(value: Any) -> Any:
    if not isinstance(value, str) or len(value) > _MOST_PATTERN or not _is_path(value):
        raise mistake(f"expected a path such as [0][2] or pose.x, got {describe_value(value)}")
    return value


def _layout(value: Any) -> Any:
    if not isinstance(value, str) or struct_of(value) is None:
        hint = "a format of Python's struct, and which of its numbers"
        raise mistake(f"expected a layout such as <Hf[1], got {describe_value(value)}", hint=hint)
    return value


Words = Annotated[list[str], BeforeValidator(_words)]
Pattern = Annotated[str, BeforeValidator(_pattern)]
Path = Annotated[str, BeforeValidator(_path)]
Layout = Annotated[str, BeforeValidator(_layout)]
ProgramKey = Annotated[str, BeforeValidator(_key)]
SignalKey = Annotated[str, BeforeValidator(_signal)]


class ReadySection(Section):
    """What tells that a program is ready. Without it one is ready when it has started."""

    line: Pattern | None = None  # a line that it prints has a match of this regular expression
    token: str | None = None  # a liveliness token of its robot is there
    key: str | None = None  # its robot has put something on this key
    port: int | None = Field(None, ge=1, le=65535)  # somebody listens on this port of this host, over TCP
    after: v.Period | None = None  # so long after its start
    within: v.Period = READY_WITHIN_NS


class StopSection(Section):
    """How a program is stopped at the end. What is still there after `within` is killed."""

    signal: Literal["INT", "TERM", "HUP", "QUIT", "KILL"] = "TERM"
    within: v.Period = STOP_WITHIN_NS


class ProgramSection(Section):
    """One program of each of some nodes."""

    run: Words
    ready: ReadySection = ReadySection.model_construct()
    stop: StopSection = StopSection.model_construct()
    env: Annotated[dict[str, str], BeforeValidator(_texts)] = {}
    folder: Annotated[str | None, Field(alias="in")] = None  # where it runs; the folder of the file
    nice: Annotated[int, Field(ge=0, le=19)] = 0


class StackSignalSection(Section):
    """A number that programs tell. It is held until they tell the next one."""

    of: Annotated[str, Field(max_length=_MOST_PATTERN)] = "*"  # a node or a pattern of nodes
    line: Pattern | None = None  # a line that a program of the node prints, with (?P<value>...) round the number
    message: str | None = None  # the key that the node puts the message on, or udp/PORT
    json_: Annotated[Path | None, Field(alias="json")] = None  # where the number is: [0][2], or pose.x
    msgpack: Path | None = None
    cbor: Path | None = None
    ros: Path | None = None  # the field of a message of ROS 2, whose type its key names
    struct: Layout | None = None  # the format of Python's struct, and which number of it: "<Hf[1]"
    count: Flag | None = None  # the number of such lines or messages so far
    unit: str = "1"

    @model_validator(mode="after")
    def _whole(self) -> StackSignalSection:
        formats = self.formats
        if (self.line is None) == (self.message is None):
            raise mistake("expected line or message: one of them tells the number")
        if self.line is not None and formats:
            raise mistake(f"{formats[0][0]} is about messages, and line has its number in (?P<value>...)")
        if self.line is not None and not self.count and "value" not in re.compile(self.line).groupindex:
            raise mistake("line names no group", hint="write (?P<value>...) round the number, or count: yes")
        if self.message is not None and len(formats) + bool(self.count) != 1:
            raise mistake(f"expected one of {', '.join(_FORMATS)} and count: how the message has its number")
        return self

    @property
    def formats(self) -> list[tuple[str, str]]:
        """The format of its message, and where the number is in it; at most one in a valid section."""
        values = (self.json_, self.msgpack, self.cbor, self.ros, self.struct)
        return [(name, value) for name, value in zip(_FORMATS, values, strict=True) if value is not None]


def nodes_of(pattern: str, nodes: Sequence[str]) -> list[str]:
    """The nodes that a name or a pattern such as `m*` means."""
    return [node for node in nodes if fnmatchcase(node, pattern)]


def programs_of(
    programs: Mapping[str, ProgramSection], nodes: Sequence[str]
) -> Iterator[tuple[str, str, ProgramSection]]:
    """(its name such as `m1` or `m1/mission`, node, section) of every program, node by node. A later entry that names
    a program once more replaces the earlier one.
    """
    for node in nodes:
        found: dict[str, ProgramSection] = {}
        for key, section in programs.items():
            pattern, slash, own = key.partition("/")
            if fnmatchcase(node, pattern):
                found[f"{node}{slash}{own}"] = section
        for name, section in found.items():
            yield name, node, section


RUNNING, DONE = "running", "done"
_Wanted = Literal["running", "done", "waived"]


def _read_endings(value: Any) -> Any:
    return {"*": value} if isinstance(value, str) else value


def _show_wanted(value: Mapping[str, str] | None) -> Any:
    return value["*"] if value is not None and list(value) == ["*"] else value


# running: it does not end by itself. done: it ends by itself before the run does, with status 0. Programs of vehicles
# may do both, but not fail; waived: they may.
ProgramsCheck = Annotated[dict[str, _Wanted], BeforeValidator(_read_endings), PlainSerializer(_show_wanted)]


def expected_ending(check: Mapping[str, str] | None, name: str, node: str) -> str:
    """What a check says of a program: the last pattern that fits its name or its node; `running` if none does."""
    fitting = [
        what for pattern, what in (check or {}).items() if fnmatchcase(name, pattern) or fnmatchcase(node, pattern)
    ]
    return fitting[-1] if fitting else RUNNING
