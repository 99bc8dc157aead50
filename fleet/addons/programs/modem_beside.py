"""The modem of a program, as its agent sees it: a program of ours beside it, and datagrams to and from that."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgpack

from agents.api import Delivery
from fleet.addons.programs.helpers import helper_command
from fleet.addons.programs.known_ports import MODEM_AGENT_PORT, MODEM_PORT
from fleet.scenario.schema.nodes import LANGUAGES
from netem.modem_frame import MARK

BEGIN_NS = 1_000_000_000_000  # CLOCK_MONOTONIC of programs at t = 0


MODEM_NAMES = ("name", "addresses")  # keys of a modem beside those of a file of nodes


class ModemBeside(NamedTuple):
    """The modem of an agent, which is not started yet."""

    command: Sequence[str]
    has_terminal: bool  # programs open it by a terminal, and not by a port


def modem_beside(number: int, given: Mapping[str, Any]) -> ModemBeside:
    """The modem of an agent.

    Args:
        number: of the agent.
        given: the modem as a file of nodes has it, and, if it is said, `name` of the vehicle and `addresses` of all
            modems by name.
    """
    modem = {key: value for key, value in given.items() if key not in MODEM_NAMES}
    settings = {
        "number": number, "begin_ns": BEGIN_NS, "name": given.get("name", f"auv{number}"),
        "addresses": given.get("addresses", {}), "modem": modem,
    }  # fmt: skip
    module = "fleet.addons.modems.modem_program"
    command = helper_command(module, json.dumps(settings), MODEM_PORT, MODEM_AGENT_PORT)
    return ModemBeside(command, any(isinstance(modem.get(language), str) for language in LANGUAGES))


def is_for_modem(delivery: Delivery) -> bool:
    """Whether a payload is a frame or news."""
    return delivery.payload.startswith(MARK)


def to_modem(delivery: Delivery, place: Sequence[float]) -> bytes:
    """The datagram that hands a payload to the modem. `place`: of the vehicle [m, NED]."""
    data: bytes = msgpack.packb([delivery.src, delivery.seq, delivery.copy, delivery.payload, list(place)])
    return data
