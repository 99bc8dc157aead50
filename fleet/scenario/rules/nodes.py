"""Rules on nodes: robots that are not ours, and what a scenario of them may hold."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec

from fleet.scenario.faults.kinds import OF_ROBOTS
from fleet.scenario.parts import Parts
from fleet.scenario.rules.report import Report
from fleet.scenario.schema.faults import FaultSection
from fleet.scenario.schema.nemesis import CONDITIONS
from fleet.scenario.schema.nodes import LANGUAGES, MOST_USBL, ModemPortSection, TopicPlace, udp_target, without_address
from fleet.scenario.schema.programs import programs_of
from fleet.scenario.schema.spec import ScenarioSpec
from fleet.scenario.text.simulated_nodes import SIMULATED, obstacles
from netem.parsing import nearest

_OF_NODES = ("carry", "discovery", "lost_after", "header", "fragments", "clock")
_CHECKS = frozenset({"max_age", "connected", "ledger", "middleware_loss", "punctual", "programs", "signal", "python"})
_OF_PROGRAMS = ("kill", "pause")  # faults of programs that the run starts


def nodes(parts: Parts, report: Report) -> None:
    """Addresses, ports, keys and places of nodes."""
    spec = parts.spec
    if spec.clock == SIMULATED and spec.nodes is not None:
        for path, message, hint in obstacles(spec):
            report.add(path, message, hint)
    if spec.nodes is None:
        for key in (*_OF_NODES, *(["log.payloads"] if spec.log.payloads is not None else [])):
            if report.has(tuple(key.split("."))):
                report.add(tuple(key.split(".")), "has no effect without nodes", key=True)
        if spec.checks.punctual is not None:
            report.add(("checks", "punctual"), "has no effect without nodes", "on_time judges a run in real time")
        return
    _addresses(parts, report)
    _isolated_nodes(parts, report)
    _ports(parts, report)
    _keys(parts, report)
    water, free = spec.network.acoustic is not None, without_address(spec.nodes)
    taken: dict[tuple[str, int | str], str] = {}  # what modems have, and which node has it
    for number, (name, node) in enumerate(spec.nodes.items(), start=1):
        if water and node.place is None:
            report.add(("nodes", name), "has no place, and sound needs one", "place: 0 0 10 m, or a topic that says it")
        if node.modem is not None:
            if not water:
                report.add(("nodes", name, "modem"), "needs water", "network: {acoustic: {queue: 10}}")
            _modem(name, number, node.modem, taken, report)
        if isinstance(node.place, TopicPlace) and not (node.listen or node.connect or name in free):
            report.add(("nodes", name, "place"), "a topic needs listen or connect")
        if isinstance(node.place, TopicPlace) and not all(map(find_spec, ("rosbags", "xxhash"))):
            report.add(("nodes", name, "place"), "a topic needs the extra ros2", "pip install 'uuv-fleet[ros2]'")
    if spec.fragments and not water:
        report.add(
            ("fragments",), "has no effect without an acoustic channel: links take packets of any size", key=True
        )
    if spec.lost_after is not None and spec.discovery != "linked":
        report.add(("lost_after",), "has no effect without discovery: linked", key=True)
    if spec.network.ideal:
        report.add(("network",), "links between nodes are ideal if nothing else is said", "leave network out")


def _modem(
    name: str, number: int, modem: ModemPortSection, taken: dict[tuple[str, int | str], str], report: Report
) -> None:
    """A modem speaks one language, and no two have one port, terminal or address."""
    if sum(getattr(modem, name) is not None for name in LANGUAGES) != 1:
        hint = "modem: {unet: 1101}, or {micromodem: /tmp/ttyAUV1}"
        report.add(("nodes", name, "modem"), "has one language", hint)
        return
    address, where, most = modem.address or number, modem.where, LANGUAGES[modem.language]
    if where and taken.setdefault(("port", where), name) != name:
        other = taken["port", where]
        report.add(("nodes", name, "modem"), f"{other} has {where}, too", "give it another, or 0: a free port")
    if taken.setdefault(("address", address), name) != name:
        other = taken["address", address]
        report.add(("nodes", name, "modem"), f"{other} has the address {address}, too", "address: N is the modem's own")
    if modem.language != "evologics":
        for key in ("mode", "usbl"):
            if getattr(modem, key) is not None:
                report.add(
                    ("nodes", name, "modem", key),
                    f"has no effect on {modem.language}: it belongs to evologics",
                    key=True,
                )
    if modem.usbl is not None and modem.usbl > MOST_USBL:
        report.add(("nodes", name, "modem", "usbl"), "must be between 0 and 45 deg", "usbl: 1 deg")
    if address > most:
        report.add(
            ("nodes", name, "modem"), f"{modem.language} has addresses up to {most}, got {address}", "address: 1"
        )


def contents(parts: Parts, report: Report) -> None:
    """The faults and checks that mean something for robots that are not ours."""
    spec = parts.spec
    if spec.nodes is None:
        return
    drawn = {*_possible(spec), *CONDITIONS}
    for number, fault in enumerate(spec.faults):
        if (wrong := why_impossible(spec, fault)) is not None:
            report.add(("faults", number), *wrong)
    if spec.nemesis is not None:
        for number, pick in enumerate(spec.nemesis.pick or ()):
            if (kind := pick.drawn or pick.kind.name) not in drawn:
                known = f"known: {', '.join(sorted(drawn))}"
                report.add(("nemesis", "pick", number), _concerns(kind), known)
        if spec.nemesis.pick is None and spec.nemesis.mode != "episodes":
            report.add_missing(("nemesis",), "pick", f": which of {', '.join(sorted(drawn))} may come")
    for key in report.keys("checks"):
        if ":" not in key and key not in _CHECKS:
            known = f"known: {', '.join(sorted(_CHECKS - {'python'}))}"
            report.add(("checks", key), "judges vehicles of ours", known, key=True)


def why_impossible(spec: ScenarioSpec, fault: FaultSection) -> tuple[str, str] | None:
    """Why a fault cannot act on these nodes, and what could; None: it can."""
    kind, possible = fault.kind.name, _possible(spec)
    if kind not in possible:
        return f"{kind} {_concerns(kind)}", f"known: {', '.join(sorted(possible))}"
    if kind in _OF_PROGRAMS and (without := _first_without_program(spec, fault.kind.vehicles(fault.values))):
        return f"{without} has no program that the run starts", "programs: {NODE: ...}"
    return None


def _possible(spec: ScenarioSpec) -> set[str]:
    return {*OF_ROBOTS, *(_OF_PROGRAMS if spec.programs else ())}


def _concerns(kind: str) -> str:
    return "concerns vehicles of ours" + (" and programs that the run starts" if kind in _OF_PROGRAMS else "")


def _first_without_program(spec: ScenarioSpec, vehicles: Sequence[int]) -> str:
    """The first of some nodes that has no program, or an empty text."""
    nodes = list(spec.nodes or ())
    having = {node for _, node, _ in programs_of(spec.programs or {}, nodes)}
    return next((nodes[i - 1] for i in vehicles if 0 < i <= len(nodes) and nodes[i - 1] not in having), "")


def _addresses(parts: Parts, report: Report) -> None:
    spec, taken = parts.spec, dict[str, str]()
    assert spec.nodes is not None
    free = without_address(spec.nodes)
    for name, node in spec.nodes.items():
        path = ("nodes", name)
        if node.listen and node.connect:
            report.add(path, "listens and connects: give one of them")
        address = node.listen or node.connect
        if address and (first := taken.setdefault(address, name)) != name:
            report.add(
                path, f"{first} has the address {address}, too; what one sends would come back through the other"
            )
        if node.zenoh and not (node.listen or node.connect or name in free):
            report.add((*path, "zenoh"), "has no effect without listen or connect", key=True)


def _isolated_nodes(parts: Parts, report: Report) -> None:
    """Who is in a network namespace of its own has its neighbours there, and nobody else."""
    spec = parts.spec
    assert spec.nodes is not None
    alone = [name for name, node in spec.nodes.items() if node.isolate]
    if not alone:
        return
    if others := [name for name in spec.nodes if name not in alone]:
        report.add(("nodes", others[0]), "nobody reaches it: others are isolated", "isolate: yes, for all nodes")
    running = {node for _, node, _ in programs_of(spec.programs or {}, list(spec.nodes))}
    for name in alone:
        node, path = spec.nodes[name], ("nodes", name)
        for key in ("listen", "connect", "udp", "modem", "zenoh"):
            if getattr(node, key):
                hint = "its programs meet at 10.0.0.1, 10.0.0.2, ...: {address} is the own one"
                report.add((*path, key), "has no effect: an isolated node is a network interface", hint, key=True)
        if isinstance(node.place, TopicPlace):
            report.add((*path, "place"), "nobody hears topics of an isolated node", "place: 0 0 10 m")
        if name not in running:
            report.add(path, "is isolated and has no program: nobody joins it from outside", "programs: ...")
    for where, section in (spec.programs or {}).items():
        for key in ("token", "key", "port"):
            if getattr(section.ready, key) is not None:
                hint = "ready: {line: ...}, or {after: 2 s}"
                report.add(("programs", where, "ready", key), "is not seen of an isolated node", hint, key=True)
    for where, signal in (spec.signals or {}).items():
        if signal.message is not None:
            report.add(("signals", where, "message"), "is not seen of isolated nodes", "line: of a program", key=True)
    if spec.compose is not None:
        report.add(("compose",), "containers are outside of the isolated nodes", "start programs in their place")
    if spec.network.acoustic is not None:
        report.add(("network", "acoustic"), "has no IP: packets of programs are too long for modems", "links, or modem")
    for key in ("carry", "discovery"):
        if getattr(spec, key) is not None:
            report.add((key,), "has no effect on isolated nodes, whose packets are not of zenoh", key=True)


def _is_here(host: str) -> bool:
    """Whether an address is one of the loopback."""
    return host == "localhost" or host.startswith("127.")


def _ports(parts: Parts, report: Report) -> None:
    spec, taken, links = parts.spec, dict[str, str](), set[tuple[str, str]]()
    assert spec.nodes is not None
    names = list(spec.nodes)
    for name, node in spec.nodes.items():
        for port, text in node.udp.items():
            path, found = ("nodes", name, "udp", port), udp_target(text)
            assert found is not None  # the schema has read it
            dst, host, to = found
            if dst not in names or dst == name:
                report.add(path, f"there is no other node {dst}", nearest(dst, [n for n in names if n != name]))
                continue
            if (names.index(name) + 1, names.index(dst) + 1) not in parts.links:
                report.add(path, f"the graph has no link {name}->{dst}", f"graph: {{edges: [{name}->{dst}]}}")
            if (name, dst) in links:
                report.add(path, f"the link {name}->{dst} has a port already", "a directed link has one port")
            if (first := taken.setdefault(port, name)) != name:
                report.add(path, f"{first} has port {port}, too")
            back = any(t.partition(":")[0] == name for t in spec.nodes[dst].udp.values())
            if not to and not back:
                hint = f"name the port of its program, as in {dst}:9100"
                report.add(path, f"{dst} sends nothing to {name}, so nobody knows where its program is", hint)
            owner = dst if back else name  # whose port they leave from
            if not _is_here(host) and _is_here(spec.nodes[owner].host):
                hint = f"nodes.{owner}.host: 0.0.0.0, or an address of this machine that {host} reaches"
                report.add(path, f"datagrams leave from {spec.nodes[owner].host}, which reaches no other host", hint)
            if host == "127.0.0.1" and any(str(to) in other.udp for other in spec.nodes.values()):
                report.add(path, f"port {to} is ours", "datagrams leave to the port of a program")
            links.add((name, dst))


def _keys(parts: Parts, report: Report) -> None:
    from netem.wire.robots import check_key  # here, because it imports zenoh

    for number, key in enumerate(parts.spec.carry or ()):
        if wrong := check_key(key):
            report.add(("carry", number), f"zenoh takes no such key expression: {wrong}", "as in */fleet/**")
