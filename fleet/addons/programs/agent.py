"""What a scenario says of a program, made into the agent that runs it."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from agents.api import Signal
from fleet.addons.programs.executables import obstacle
from fleet.addons.programs.helpers import own_python
from fleet.addons.programs.library import NoLibraryError, compile_library
from fleet.addons.programs.line_signal import LineSignal
from fleet.addons.programs.message_signal import MessageSignal, plain_reader
from fleet.addons.programs.modem_beside import MODEM_NAMES
from fleet.addons.programs.process_agent import PROCESSORS, OtherProgram, ProcessAgent, ReadyLine, epoch_ns
from fleet.addons.programs.udp_ways import UdpWays
from fleet.scenario.schema.nodes import ModemPortSection
from fleet.scenario.schema.programs import StackSignalSection
from netem.wire.key_expression import matching
from world.errors import PluginError

_PARAMETERS = (
    "module", "interpreter", "arguments", "signals", "addresses", "env", "files", "epoch", "processors", "setup",
    "vehicle", "udp", "modem", "beside", "ends", "ready",
)  # fmt: skip
# Of 1.0, where Python ran on stand-ins. Those with a value here need nothing any more.
_OF_BEFORE = {"process": (True, "yes"), "order": ("ready",), "shared": None}
_GONE = {
    "order": "callbacks of asyncio run in asyncio's own order",
    "cost": "computing takes no time; a program that takes time sleeps",
    "process": "a program always is a process of its own",
}
_ROS_VEHICLE = Path(__file__).with_name("ros_vehicle.py")
MOST_PROCESSORS = 64  # that a process sees


def program_class(path: Path, parameters: Mapping[str, Any]) -> type[ProcessAgent]:
    """The agent that a program makes with some parameters. Nothing of it runs yet.

    Args:
        path: the program: a file of Python, or anything that can be executed.
        parameters: those of the guide.

    Raises:
        PluginError: there is no such parameter, or one has no meaning, or the program cannot run here.
    """
    _check_keys(path, parameters)
    told = {name: _signal(path, name, about) for name, about in dict(parameters.get("signals") or {}).items()}
    setup = _setup(path, parameters.get("setup"))
    python = "python3" if setup else own_python()
    interpreter = parameters.get("interpreter") or (python if path.suffix == ".py" else "")
    if "/" in interpreter and (file := _find_beside(path, interpreter)):
        interpreter = str(file)
    found = shutil.which(interpreter) if interpreter else None
    if interpreter and found is None:
        raise _wrong(path, f"interpreter: there is no command {interpreter!r}", "give its path, or install it")
    if problem := obstacle(found or path):
        raise _wrong(path, problem)
    if not interpreter and not os.access(path, os.X_OK):
        raise _wrong(
            path, "it cannot be executed", "chmod +x, or say by which interpreter, such as `interpreter: node`"
        )
    _check_values(path, parameters)
    node = (*setup, (interpreter if setup else found) or python, str(_ROS_VEHICLE)) if parameters.get("vehicle") else ()
    try:
        compile_library()
    except NoLibraryError as error:
        raise _wrong(path, str(error)) from None

    module = str(parameters.get("module") or "")  # its folder is the one in which its package lies
    variables_of_module = {"PYTHONPATH": str(path.resolve().parents[module.count(".")])} if module else {}
    words = ("-m", module) if module else (str(path),)

    alone = (*setup, *((interpreter if setup else found, *words) if found else words))
    others = _others(path, parameters.get("beside") or {})

    class Program(ProcessAgent):
        plugin_file = path
        command = alone
        together = others
        ends = _ends(parameters.get("ends"))
        awaits = _ready_lines(path, parameters.get("ready") or ())
        variables = variables_of_module
        beside = node
        reads = tuple(each for each in told.values() if isinstance(each, LineSignal))
        watches = tuple(each for each in told.values() if isinstance(each, MessageSignal))
        signals = tuple(Signal(name, "1", "as the program told it last") for name in told)

    return Program


def _others(path: Path, given: Any) -> tuple[OtherProgram, ...]:
    """The programs that run beside it on its host. Raises PluginError: one cannot run here, or is described wrongly."""
    if not isinstance(given, Mapping):
        raise _wrong(
            path, f"beside: expected programs by name, got {given!r:.80}", "{pilot: {run: [python, pilot.py]}}"
        )
    others = []
    for name, each in given.items():
        if not isinstance(each, Mapping) or not (words := each.get("run")) or not isinstance(words, list | tuple):
            raise _wrong(path, f"beside.{name}: expected a command line in `run`", "{run: [python, pilot.py]}")
        if unknown := sorted(each.keys() - {"run", "env", "ends"}):
            raise _wrong(path, f"beside.{name}: there is no key {unknown[0]!r}", "known: run, env, ends")
        first = own_python() if words[0] in ("python", "python3") else shutil.which(str(words[0]))
        first = first or (str(file.resolve()) if (file := _find_beside(path, str(words[0]))) else None)
        if first is None:
            raise _wrong(path, f"beside.{name}: there is no command {words[0]!r}", "give its path, or install it")
        if problem := obstacle(Path(first)):
            raise _wrong(path, f"beside.{name}: {problem}")
        rest = [str(file.resolve()) if (file := _find_beside(path, str(word))) else str(word) for word in words[1:]]
        others.append(OtherProgram(str(name), (first, *rest), dict(each.get("env") or {}), _ends(each.get("ends"))))
    return tuple(others)


def _ready_lines(path: Path, given: Any) -> tuple[ReadyLine, ...]:
    """The lines that say that programs are ready. Raises PluginError: one is described wrongly."""
    try:
        return tuple(ReadyLine(str(e["name"]), re.compile(e["line"]), round(float(e["within_s"]) * 1e9)) for e in given)
    except (KeyError, TypeError, ValueError, re.error) as error:
        hint = "[{name: pilot, line: 'up and running', within_s: 20}]"
        raise _wrong(path, f"ready: expected lines that say so ({error})", hint) from None


def _ends(value: Any) -> str:
    """Whether a program may end by itself, as `several_programs` has it."""
    return "any" if value == "any" else "yes" if value in (True, "yes") else "no"


def _check_keys(path: Path, parameters: Mapping[str, Any]) -> None:
    for key, value in parameters.items():
        if key in _PARAMETERS:
            continue
        if key in _OF_BEFORE and (_OF_BEFORE[key] is None or value in (_OF_BEFORE[key] or ())):
            continue
        if key in _GONE:
            raise _wrong(path, f"{key}: {_GONE[key]}", "remove the key")
        raise _wrong(path, f"there is no key {key!r}", f"known: {', '.join(_PARAMETERS)}")


def _check_values(path: Path, parameters: Mapping[str, Any]) -> None:
    folder = path.parent
    files = parameters.get("files") or ()
    if not isinstance(files, list | tuple) or not all(isinstance(each, str) for each in files):
        raise _wrong(path, f"files: expected a list of files and folders, got {files!r:.80}")
    for each in files:
        if not (folder / each).exists():
            raise _wrong(path, f"files: there is no {each} in {folder}")
    if not isinstance(parameters.get("env") or {}, Mapping):
        raise _wrong(path, f"env: expected {{NAME: value}}, got {parameters['env']!r:.80}")
    if not isinstance(parameters.get("arguments") or [], list | tuple):
        raise _wrong(path, f"arguments: expected a list of words, got {parameters['arguments']!r:.80}")
    try:
        epoch_ns(str(parameters.get("epoch") or "2026-01-01"))
    except ValueError as error:
        raise _wrong(path, f"epoch: {error}", "write a date and a time, such as 2026-06-01T12:00:00") from None
    processors = parameters.get("processors", PROCESSORS)
    if not isinstance(processors, int) or not 1 <= processors <= MOST_PROCESSORS:
        raise _wrong(path, f"processors: expected 1 to {MOST_PROCESSORS}, got {processors!r}")
    try:
        UdpWays(parameters.get("udp") or {})
    except (ValueError, TypeError, AttributeError):
        raise _wrong(path, f"udp: expected {{PORT: [AGENT, PORT]}}, got {parameters['udp']!r:.80}") from None
    _check_modem(path, parameters.get("modem"))
    vehicle = parameters.get("vehicle", "")
    if vehicle not in ("", "ros2"):
        raise _wrong(
            path, f"vehicle: expected ros2, got {vehicle!r}", "others need no key: the guide says what they hear"
        )


def _check_modem(path: Path, given: Any) -> None:
    """See whether a modem is one as a file of nodes has it. Raises PluginError: it is not."""
    if given is None:
        return
    hint = "modem: {unet: 1100}, {micromodem: PORT or PATH}, or {evologics: 9200}; see the guide of modems"
    if not isinstance(given, Mapping):
        raise _wrong(path, f"modem: expected a language and a port, got {given!r:.80}", hint)
    try:
        section = ModemPortSection.model_validate({k: v for k, v in given.items() if k not in MODEM_NAMES})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, ("modem", *first["loc"])))
        raise _wrong(path, f"{where}: {first['msg']}", hint) from None
    if not section.where:
        raise _wrong(path, "modem: expected a language with a port that is not 0, or with a path", hint)


def _setup(path: Path, name: Any) -> tuple[str, ...]:
    """The beginning of a command line that reads a file of a shell first, such as `setup.bash` of ROS 2; (): none."""
    if not name:
        return ()
    file = _find_beside(path, str(name))
    if file is None:
        hint = "give a file of bash, beside the program or where you are, such as /opt/ros/jazzy/setup.bash"
        raise _wrong(path, f"setup: there is no file {name}", hint)
    # In a function, so that the file does not see the program's arguments.
    return "/bin/bash", "-c", 'setup() { . "$0"; }; setup; exec "$@"', str(file.resolve())


def _find_beside(path: Path, name: str) -> Path | None:
    """A file beside the program, or where the user is. Its name stays: a link to a Python is another Python."""
    given = Path(name).expanduser()
    folders = path.parent.absolute(), Path.cwd()
    return next((file for folder in folders if (file := folder / given).is_file()), None)


def _wrong(path: Path, problem: str, hint: str = "") -> PluginError:
    return PluginError("agent", f"program:{path.name}", problem, hint)


def _signal(path: Path, name: str, about: Any) -> LineSignal | MessageSignal:
    """A signal that lines tell, or messages, in the words of a file of nodes. Raises PluginError: it is none."""
    if not isinstance(about, Mapping) or "message" not in about:
        return _line_signal(path, name, about)
    try:
        section = StackSignalSection.model_validate(about)
    except ValidationError as error:
        first = error.errors()[0]
        raise _wrong(path, f"signals.{name}: {first['msg']}") from None
    if section.ros is not None:
        raise _wrong(path, f"signals.{name}: messages of ROS 2 are not read in simulated time", "line: what it prints")
    assert section.message is not None  # the schema has seen it
    number = plain_reader(*section.formats[0]) if section.formats else None
    return MessageSignal(name, matching(section.message), number)


def _line_signal(path: Path, name: str, about: Any) -> LineSignal:
    text = about.get("line") if isinstance(about, Mapping) else about
    try:
        pattern = re.compile(str(text))
    except re.error as error:
        raise _wrong(path, f"signals.{name}.line is no regular expression: {error}") from None
    counts = isinstance(about, Mapping) and bool(about.get("count"))
    if not counts and "value" not in pattern.groupindex:
        hint = "write (?P<value>...) round the number, or count: true"
        raise _wrong(path, f"signals.{name}.line names no group", hint)
    return LineSignal(name, pattern, counts)
