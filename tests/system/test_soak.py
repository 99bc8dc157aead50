"""The soak in small: two minutes of random faults. `fleet bench soak` is the long one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fleet.bench.soak import measure_soak, soak_failures


@pytest.mark.slow
def test_two_minutes_of_random_faults() -> None:
    rows = measure_soak(5, 120.0, 120.0, lambda text: None)
    assert soak_failures(rows) == []
    assert [row.run for row in rows] == ["in-process", "again", "distributed"]
    assert all(row.simulated_s == 120.0 and row.restarts >= 2 for row in rows)
    # What grows with the run is what the verdicts and the log's index need; a leak of messages would be far more.
    assert all(row.warm_mb > 0 and row.end_mb < 1.5 * row.warm_mb for row in rows)

    (good, *_) = rows
    assert "ledger 1->2 off by 3" in soak_failures([replace(good, ledger="1->2 off by 3")])[0]
    assert "1 processes" in soak_failures([replace(good, orphans=1)])[0]
    assert "differ" in soak_failures([good, replace(good, digest="0")])[0]
    assert "broken" in soak_failures([replace(good, status="broken")])[0]
