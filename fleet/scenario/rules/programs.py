"""Rules on programs of nodes, on the signals that they tell, and on what only a scenario with programs may hold."""

from __future__ import annotations

from pathlib import Path

from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report
from fleet.scenario.schema.checks import WAIVED
from fleet.scenario.schema.programs import (
    OF_KEYS,
    PLACEHOLDERS,
    fill_placeholders,
    no_placeholder,
    nodes_of,
    programs_of,
)
from netem.parsing import nearest

_LIKE = 0.8  # {nodes} and {node}, and not {code}
_OF_PROGRAMS = ("begin", "signals", "compose")


def programs(parts: Parts, report: Report) -> None:
    """Each program is one of a node, in a folder that is there, and what it needs is known when it starts."""
    spec = parts.spec
    if spec.nodes is None:
        for key in ("programs", *_OF_PROGRAMS):
            if report.has((key,)):
                report.add((key,), "has no effect without nodes", key=True)
        if spec.names is None and spec.checks.programs not in (None, {"*": WAIVED}):  # judged by how they end
            report.add(("checks", "programs"), "has no effect without nodes", key=True)
        return
    if not spec.programs:
        for path in (("begin",), ("compose",), ("checks", "programs")):
            if report.has(path):
                report.add(path, "has no effect without programs", key=True)
        if any(signal.line is not None for signal in (spec.signals or {}).values()):
            report.add(("signals",), "lines are those of programs, and there are none", "programs: {m1: {run: [...]}}")
    names = list(spec.nodes)
    for key, section in (spec.programs or {}).items():
        path, pattern = ("programs", key), key.partition("/")[0]
        if not nodes_of(pattern, names):
            report.add(path, f"there is no node {pattern}", _hint(pattern, names), key=True)
        folder = Path(parts.folder or "", section.folder or "")
        if not folder.is_dir():
            report.add((*path, "in"), f"there is no folder {folder}", "it is looked for from the folder of the file")
        filled_in = {("run",): " ".join(section.run)} | {("env", name): text for name, text in section.env.items()}
        for where, text in filled_in.items():
            if wrong := no_placeholder(text, PLACEHOLDERS, _LIKE):
                report.add((*path, *where), wrong)
        ready = section.ready
        for kind in ("key", "token"):
            if wrong := no_placeholder(getattr(ready, kind) or "", OF_KEYS):
                report.add((*path, "ready", kind), wrong)
        given = [kind for kind in ("line", "token", "key", "port", "after") if getattr(ready, kind) is not None]
        if len(given) > 1:
            report.add((*path, "ready"), f"expected one condition, got {' and '.join(given)}")
        if ready.after is not None and ready.after > ready.within:
            report.add((*path, "ready", "after"), "is longer than within", "within: the longest wait")
    started = list(programs_of(spec.programs or {}, names))
    for pattern, what in (spec.checks.programs or {}).items() if started else ():
        if what == WAIVED:
            report.add(("checks", "programs"), f"expected running or done, got {WAIVED}")
        if not any(nodes_of(pattern, [name, node]) for name, node, _ in started):
            known = [name for name, _, _ in started]
            hint = nearest(pattern, known) or f"the programs are {', '.join(known)}"
            report.add(("checks", "programs", pattern), f"there is no program {pattern}", hint, key=True)
    told = [text for section in (spec.programs or {}).values() for text in (*section.run, *section.env.values())]
    early = any("{begin_s}" in text for text in told)
    for _, node, section in started:
        ready = section.ready
        if early and any(kind is not None for kind in (ready.line, ready.token, ready.key, ready.port)):
            hint = "ready: {after: 2 s} for all programs; or leave {begin_s} out"
            report.add(("programs",), f"{{begin_s}} is not known before {node} is ready", hint)
            break


def signals(parts: Parts, report: Report) -> None:
    """Each signal is one of a node."""
    spec = parts.spec
    nodes = list(spec.nodes or ())
    for name, section in (spec.signals or {}).items() if nodes else ():
        found = nodes_of(section.of, nodes)
        if not found:
            report.add(("signals", name, "of"), f"there is no node {section.of}", _hint(section.of, nodes))
        key = section.message
        if key is None:
            continue
        if wrong := no_placeholder(key, OF_KEYS):
            report.add(("signals", name, "message"), wrong)
            continue
        if key.startswith("udp/"):
            ports = {node: [f"udp/{port}" for port in (spec.nodes or {})[node].udp] for node in found}
            keys = [fill_placeholders(key, {"node": node, "number": nodes.index(node) + 1}) for node in found]
            if found and not any(one in ports[node] for one, node in zip(keys, found, strict=True)):
                known = ", ".join(port for some in ports.values() for port in some)
                hint = f"they have {known}" if known else "nodes: {NODE: {udp: {PORT: ...}}}"
                report.add(("signals", name, "message"), f"none of its nodes has the port {keys[0]}", hint)
            continue
        if section.ros is not None:
            key = key.strip("/")  # of a topic, which ROS names with a slash in front
        from netem.wire.robots import check_key  # here, because it imports zenoh

        for number, node in enumerate(nodes, start=1):
            if node in found and (wrong := check_key(fill_placeholders(key, {"node": node, "number": number}))):
                report.add(("signals", name, "message"), f"zenoh takes no such key expression: {wrong}")
                break


def _hint(name: str, names: list[str]) -> str:
    return nearest(name, names) or f"the nodes are {', '.join(names)}"
