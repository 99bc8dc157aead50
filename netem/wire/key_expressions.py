"""Key expressions by zenoh's own rules, for who has no session."""

from __future__ import annotations

from functools import lru_cache

import zenoh

KeyExpression = zenoh.KeyExpr


@lru_cache(4096)
def key_expression(text: str) -> zenoh.KeyExpr:
    """The key expression of a text.

    Args:
        text: such as `fleet/*/pose`.

    Raises:
        zenoh.ZError: it is none.
    """
    return zenoh.KeyExpr(text)


@lru_cache(65_536)
def intersects(expression: zenoh.KeyExpr, text: str) -> bool:
    """Whether some key fits both a key expression and another one, given as text."""
    return bool(expression.intersects(key_expression(text)))
