"""The picture of the rooms: drawn from the code, and stored with every room in it."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from repository import ROOT

pytest.importorskip("grimp", reason="import-linter is not installed: '.[test-all]'")

from rooms import imports, named, rooms, svg

STORED = ROOT / "docs" / "rooms.svg"


def test_every_room_is_in_the_picture_that_is_drawn_and_in_the_stored_one() -> None:
    sizes = rooms()
    assert {"fleet.recorder.scene", "fleet.addons.page", "netem.wire"} <= sizes.keys() and all(sizes.values())
    picture = svg(sizes, imports(list(sizes)))
    ElementTree.fromstring(picture)
    assert sizes.keys() == named(picture) == named(STORED.read_text("utf-8")), (
        "draw it again: python benchmarks/rooms.py > docs/rooms.svg"
    )
    assert "<title>fleet.addons.page imports fleet.recorder.scene: " in picture
    assert "<title>netem imports world" not in picture


def test_rooms_stand_in_the_order_of_the_floors() -> None:
    order = list(rooms())
    wanted = [
        "fleet.addons.robots",
        "fleet.addons.page",
        "fleet.addons.pictures",
        "fleet.cli",
        "fleet.recorder",
        "fleet.recorder.scene",
        "fleet.scenario",
        "agents",
        "world",
        "netem",
    ]
    assert sorted(wanted, key=order.index) == wanted
