"""The line for each node that tells a user how the programs of a robot meet us."""

from __future__ import annotations

import os
import pwd
import re
import socket
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from shlex import quote
from types import MappingProxyType

from fleet.analysis.link_shares import link_lines
from fleet.scenario.scenario import Scenario, timeline_lines
from fleet.scenario.schema.nodes import Node, without_address
from fleet.scenario.schema.programs import programs_of

_LOOPBACK = ("127.", "localhost", "[::1]")
_EVERY = re.compile(r"/(0\.0\.0\.0|\[::\])(?=:)")  # every address of this host
_PEOPLE = range(1000, 60_000)  # the numbers of the accounts of people


def lines(
    scenario: Scenario,
    found: Mapping[str, str] = MappingProxyType({}),
    modems: Mapping[str, str] = MappingProxyType({}),
) -> Iterator[str]:
    """For each node the programs that the run starts, or the address that those of the user need, and how those of
    ROS 2 get it. `found`: the addresses of nodes that say none; `modems`: the ports of modems. They are empty as long
    as nothing is open.
    """
    nodes = scenario.spec.nodes or {}
    started: dict[str, list[str]] = {}
    for _, whose, section in programs_of(scenario.spec.programs or {}, scenario.nodes):
        started.setdefault(whose, []).append(f"runs {' '.join(map(quote, section.run))}")
    free = without_address(nodes)
    width = max(map(len, scenario.nodes))
    for name, node in nodes.items():
        if name in started:
            yield from (f"{name:{width}}  {said}" for said in started[name])
            continue
        if name in free and name not in found:
            yield f"{name:{width}}  gets a free port of this host, which fleet netem tells"
        for said in _address_lines(node, found.get(name, ""), modems.get(name, "")):
            yield f"{name:{width}}  {said}"


def _address_lines(node: Node, found: str, opened: str) -> Iterator[str]:
    if (modem := node.modem) is not None:
        where = opened or modem.where or "a free port, which fleet netem tells"
        host = socket.gethostname() if modem.host == "0.0.0.0" else modem.host
        if modem.language == "unet":
            yield f"modem of UnetStack: UnetSocket('{host}', {where})"
        elif modem.language == "evologics":
            begins = "commands alone" if modem.mode == "command" else "data, and commands behind +++"
            yield f"modem of EvoLogics (experimental): TCP {host}:{where}, for {begins}"
        else:
            yield f"Micro-Modem: {where if isinstance(modem.where, str) else f'TCP {host}:{where}'}"
    if listen := node.listen or found:
        address = _EVERY.sub(f"/{socket.gethostname()}", listen)
        yield f"""export ZENOH_CONFIG_OVERRIDE='connect/endpoints=["{address}"]'"""
    elif node.connect:
        yield f"joins the router at {node.connect}"
    for port, target in node.udp.items():
        yield f"UDP to 127.0.0.1:{port} goes to {target}"


def warnings(scenario: Scenario) -> Iterator[str]:
    """Ports that other machines, or other users of this one, reach and that ask for no password."""
    nodes = (scenario.spec.nodes or {}).items()
    here = []
    for name, node in nodes:
        modem = node.modem
        if modem is not None and not isinstance(modem.where, str):
            if modem.host.startswith(_LOOPBACK):
                here.append(name)
            else:
                yield f"{name} opens its modem on {modem.host} for other machines, and modems ask for no password"
        kind, _, address = (node.listen or "").partition("/")
        if not node.listen or node.zenoh or kind == "unixsock-stream":
            continue
        if address.startswith(_LOOPBACK):
            here.append(name)
        else:
            yield (
                f"{name} listens on {node.listen} for other machines, and the port has no password; "
                "give it a file of zenoh's configuration (zenoh: FILE.json5) with TLS and users"
            )
    free = without_address(dict(nodes))
    here = list(dict.fromkeys([*here, *(name for name, node in nodes if node.udp or name in free)]))
    if here and (others := _other_people()):
        who = f"other users of this machine ({', '.join(others)})"
        hint = "listen on unixsock-stream/PATH in a folder of yours, or use zenoh's users"
        yield f"{who} can hear the programs of {', '.join(here)} and speak for them: ports have no password; {hint}"


def _other_people() -> list[str]:
    """Some other people who can log in on this machine and have processes on it now. Who is not there hears nothing,
    and a warning that comes at every start is read by nobody.
    """
    found = [one for one in pwd.getpwall() if one.pw_uid in _PEOPLE and one.pw_uid != os.getuid()]
    able = [one for one in found if Path(one.pw_shell).name not in ("nologin", "false", "")]
    there = users_now() if able else None
    return sorted(one.pw_name for one in able if there is None or one.pw_uid in there)[:3]


def users_now() -> set[int] | None:
    """The numbers of the users with processes; None: the system shows us only our own."""
    found = set()
    for name in os.listdir("/proc"):
        if name.isdigit():
            with suppress(OSError):  # it has ended
                found.add(os.stat(f"/proc/{name}").st_uid)
    return found if os.path.exists("/proc/1") else None


def summary(scenario: Scenario) -> list[str]:
    """The lines of `fleet check` about a valid file."""
    links = [scenario.link_name(link) for link in scenario.graph.links]
    ends = f"ends after {scenario.duration_ns / 1e9:g} s" if scenario.ends else "runs until it is stopped"
    first = f"{scenario.name}: valid. {len(scenario.nodes)} nodes, {len(links)} directed links; it {ends}"
    return [first, f"links: {', '.join(links)}", *link_lines(scenario), *timeline_lines(scenario), *lines(scenario)]
