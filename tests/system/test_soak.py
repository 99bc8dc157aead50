"""The soak in small: two minutes of random faults. `fleet bench soak` is the long one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fleet.bench.soak import measure, verdicts


@pytest.mark.slow
def test_two_minutes_of_random_faults() -> None:
    rows = measure(5, 120.0, 120.0, lambda text: None)
    assert verdicts(rows) == []
    assert [row.run for row in rows] == ["in-process", "again", "distributed"]
    assert all(row.simulated_s == 120.0 and row.restarts >= 2 for row in rows)
    # What grows with the run is what the verdicts and the log's index need; a leak of messages would be far more.
    assert all(row.warm_mb > 0 and row.end_mb < 1.5 * row.warm_mb for row in rows)

    (good, *_) = rows
    assert "ledger 1->2 off by 3" in verdicts([replace(good, ledger="1->2 off by 3")])[0]
    assert "1 processes" in verdicts([replace(good, orphans=1)])[0]
    assert "differ" in verdicts([good, replace(good, digest="0")])[0]
    assert "broken" in verdicts([replace(good, status="broken")])[0]
