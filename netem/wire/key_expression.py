"""Key expressions of zenoh, as patterns of names."""

from __future__ import annotations

from collections.abc import Callable

import zenoh


def matching(text: str) -> Callable[[str], bool]:
    """Whether a name is included in a key expression such as `uuv/*/state` or `link/**`.

    A text or name that zenoh does not accept as a key expression matches only itself. `*` and `**` do not include parts
    that begin with `@`, which zenoh asks to be named.

    https://github.com/eclipse-zenoh/roadmap/blob/main/rfcs/ALL/Key%20Expressions.md
    """
    try:
        expression = zenoh.KeyExpr.autocanonize(text)
    except zenoh.ZError:
        return lambda name: name == text

    def included(name: str) -> bool:
        try:
            return expression.includes(zenoh.KeyExpr(name))
        except zenoh.ZError:
            return name == text

    return included


def is_key(name: str) -> bool:
    """Whether zenoh can publish on a name, and on it alone."""
    try:
        zenoh.KeyExpr(name)
    except zenoh.ZError:
        return False
    return "*" not in name
