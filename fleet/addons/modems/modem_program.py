"""The modem of an agent that is a program: a program of ours beside it, in its simulated time and on its host.

It opens the modem's port or terminal for the agent's programs, speaks the modem's language with them, and passes
payloads to and from the agent as datagrams: of the agent's payloads each as it is; to it, MessagePack of
`[sender, number, copy, payload, place]`.

    python -m fleet.addons.modems.modem_program SETTINGS PORT AGENT_PORT

SETTINGS are JSON: `number`, `begin_ns`, `name`, `addresses`, and `modem` as a file has it. PORT is ours, AGENT_PORT the
agent's, both of 127.0.0.1.
"""

from __future__ import annotations

import json
import os
import socket
import sys
from contextlib import suppress

import msgpack

from fleet.addons.modems.agent_modem import AgentModem
from fleet.addons.modems.languages import modem_core
from fleet.scenario.schema.nodes import ModemPortSection
from netem.errors import BusError

_HOST = "127.0.0.1"


def main(settings: str, port: str, agent_port: str) -> str | None:
    """Serve without an end. Returns what is wrong."""
    given = json.loads(settings)
    section = ModemPortSection.model_validate(given["modem"])
    core = modem_core(given["number"], section)
    if isinstance(section.where, str):
        with suppress(FileNotFoundError):  # a former life of the program may have left it, and the disk is its own
            os.unlink(section.where)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind((_HOST, int(port)))
        try:
            core.listen()
        except BusError as error:
            return str(error)
        modem = AgentModem(
            core,
            given["name"],
            given["addresses"],
            given["begin_ns"],
            lambda data: ours.sendto(data, (_HOST, int(agent_port))),
        )
        remarked = ""
        while True:
            src, seq, copy, payload, place = msgpack.unpackb(ours.recv(1 << 17), use_list=False)
            modem.hear(src, seq, copy, payload, place)
            if core.remark != remarked:
                remarked = core.remark
                print(f"modem: {remarked}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
