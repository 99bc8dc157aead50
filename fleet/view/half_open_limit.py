"""How many connections may be open that have not sent a request, and how long: of the page and of Foxglove's server."""

from __future__ import annotations

import resource

MOST = 100  # or a quarter of the files that the process may open, if that is less
FOR_S = 5.0


def most_half_open() -> int:
    """How many at once."""
    return max(1, min(MOST, resource.getrlimit(resource.RLIMIT_NOFILE)[0] // 4))
