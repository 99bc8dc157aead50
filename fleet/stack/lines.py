"""The line for each node that tells a user how the programs of a robot meet us."""

from __future__ import annotations

from collections.abc import Iterator

from fleet.analysis.link_shares import link_lines
from fleet.scenario.scenario import Scenario, timeline_lines
from fleet.scenario.schema.nodes import Node

_LOOPBACK = ("127.", "localhost", "[::1]", "unixsock")


def lines(scenario: Scenario) -> Iterator[str]:
    """For each node the address that its programs need, and how those of ROS 2 get it."""
    width = max(map(len, scenario.nodes))
    for name, node in (scenario.spec.nodes or {}).items():
        for said in _of(node):
            yield f"{name:{width}}  {said}"


def _of(node: Node) -> Iterator[str]:
    if node.listen:
        yield f"""export ZENOH_CONFIG_OVERRIDE='connect/endpoints=["{node.listen}"]'"""
    elif node.connect:
        yield f"joins the router at {node.connect}"
    for port, target in node.udp.items():
        yield f"UDP to 127.0.0.1:{port} goes to {target}"


def warnings(scenario: Scenario) -> Iterator[str]:
    """Ports that other machines reach and that ask for no password."""
    for name, node in (scenario.spec.nodes or {}).items():
        if node.listen and not node.listen.partition("/")[2].startswith(_LOOPBACK) and not node.zenoh:
            yield (
                f"{name} listens on {node.listen} for other machines, and the port has no password; "
                "give it a file of zenoh's configuration (zenoh: FILE.json5) with TLS and users"
            )


def summary(scenario: Scenario) -> list[str]:
    """The lines of `fleet check` about a valid file."""
    links = [scenario.link_name(link) for link in scenario.graph.links]
    ends = f"ends after {scenario.duration_ns / 1e9:g} s" if scenario.ends else "runs until it is stopped"
    first = f"{scenario.name}: valid. {len(scenario.nodes)} nodes, {len(links)} directed links; it {ends}"
    return [first, f"links: {', '.join(links)}", *link_lines(scenario), *timeline_lines(scenario), *lines(scenario)]
