"""World and netem before agents that share a process, on a bus that is none."""

from __future__ import annotations

from itertools import chain

import pytest
from nowhere import Nowhere, serve

import world.process
from fleet.scenario.loading import load_scenario
from netem.process import NetemProcess
from netem.rounds import Rounds
from netem.wire.codec import decode, encode
from netem.wire.keys import Keys
from netem.wire.messages import Bundle, BundlePart, Command, Grant, Inbox, Nav, Note, Round, Transmission
from world.lockstep import Lockstep
from world.process import WorldProcess

SCENARIO = load_scenario("paper", ["duration=300 ms", "checks={}"])
KEYS = Keys("f0220000")
COMMAND = Command(0, 0, (1.0, 0.1, -0.1), (0.0,) * SCENARIO.layout(1).size)
MEMBERS = ((1, 2), (3,))


def said(bus: Nowhere, kind: type, key: str) -> list[int]:
    """The messages of a kind in the bundles on a key, by vehicle."""
    bundles = [decode(data) for where, data in bus.put if where == key]
    parts = chain.from_iterable(bundle.parts for bundle in bundles if isinstance(bundle, Bundle))
    return [part.vehicle for part in parts if isinstance(decode(part.message), kind)]


def notes(bus: Nowhere) -> list[str]:
    return [note.text for _, data in bus.put if isinstance(note := decode(data), Note)]


def test_the_world_asks_a_host_in_one_message_and_takes_what_its_own_agents_say() -> None:
    bus = Nowhere()
    run = Lockstep(SCENARIO.world_config)
    process = WorldProcess(bus, KEYS, run, members=MEMBERS)  # type: ignore[arg-type]
    parts = tuple(BundlePart(i, encode(COMMAND)) for i in (1, 3, 2))
    bus.queue += [(KEYS.grant, encode(Grant(1))), (KEYS.cmd("host-1"), encode(Bundle(parts)))]
    serve(process)
    assert said(bus, Nav, KEYS.host(1)) == [1, 2]
    assert said(bus, Nav, KEYS.host(2)) == [3]
    assert isinstance(decode(next(data for key, data in bus.put if key == KEYS.nav(4))), Nav)
    (note,) = notes(bus)
    assert note == f"rejected on {KEYS.cmd(3)}: malformed bundle message: vehicle 3 is not on host-1"
    assert [i for i, _ in run.waiting_for] == [3, 4]


def test_netem_answers_a_host_in_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """And takes a round in parts, in the form in which the world sends a long one."""
    monkeypatch.setattr(world.process, "PART_BYTES", 2 * world.process.ROUND_BYTES)
    bus, config = Nowhere(), SCENARIO.netem_config
    asked = Nowhere()
    run = Lockstep(SCENARIO.world_config)
    process = WorldProcess(asked, KEYS, run)  # type: ignore[arg-type]
    process._publish([Round(0, (1, 2, 3, 4), ((0.0, 0.0, 1.0),) * 4, ())])
    rounds = [(key, data) for key, data in asked.put if key == KEYS.round]
    assert [isinstance(decode(data), Round) for _, data in rounds] == [True, True]
    network = NetemProcess(bus, KEYS, config, Rounds(config), MEMBERS)  # type: ignore[arg-type]
    nothing = encode(Transmission(0, 0, ()))
    bus.queue += [
        (KEYS.tx("host-1"), encode(Bundle((BundlePart(4, nothing), BundlePart(1, nothing), BundlePart(2, nothing))))),
        (KEYS.tx(4), nothing),
        *rounds,
        (KEYS.tx("host-2"), encode(Bundle((BundlePart(3, nothing),)))),
    ]
    serve(network)
    assert [said(bus, Inbox, KEYS.host(h)) for h in (1, 2)] == [[1, 2], [3]]
    assert isinstance(decode(next(data for key, data in bus.put if key == KEYS.rx(4))), Inbox)
    assert notes(bus) == [f"rejected on {KEYS.tx(4)}: malformed bundle message: vehicle 4 is not on host-1"]
