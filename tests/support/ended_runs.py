"""Settings of runs that are disturbed or ended in the middle."""

from __future__ import annotations

# Of which the first seconds are seen; the rest is more than any machine needs until then.
LONG = ["--duration", "600 s", "--speed", "5", "--set", "on_death=abort"]
OURS = "ledger: balanced, middleware_loss: {at_most: 0}"
CHECKS = f"checks={{qp_infeasible: {{at_most: 0}}, {OURS}, tumbled: waived, deaths: waived}}"
