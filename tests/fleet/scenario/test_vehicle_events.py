"""What happened to vehicles is told once for each, apart from the faults."""

from __future__ import annotations

from fleet.scenario.sections.vehicle_events import vehicle_events


def test_a_row_for_each_vehicle_and_kind() -> None:
    happened = [("tumbled 3", 12.45), ("tumbled 2", 13.0), ("tumbled 3", 20.0), ("diverged 2", 14.0)]
    assert [str(row) for row in vehicle_events(happened)] == [
        "tumbled 3: 2 times, first at 12.45 s",
        "tumbled 2: at 13 s",
        "diverged 2: at 14 s",
    ]


def test_the_first_is_the_earliest_in_any_order() -> None:
    assert vehicle_events([("tumbled 1", 9.0), ("tumbled 1", 3.0)])[0].first_s == 3.0
    assert vehicle_events([]) == []
