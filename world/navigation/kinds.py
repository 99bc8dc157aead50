"""The navigation of a vehicle, as its configuration asks for it."""

from __future__ import annotations

from world.navigation.config import Navigation, NavigationTrace
from world.navigation.navigator import Navigator, State
from world.navigation.replay import ReplayedError


def navigation_of(
    config: Navigation | None, seed: int, i: int, tick_ns: int, state: State
) -> Navigator | ReplayedError | None:
    """The navigation of vehicle i, from its true state at the start; None: the vehicle knows where it is."""
    if config is None:
        return None
    if isinstance(config, NavigationTrace):
        return ReplayedError(config, tick_ns)
    return Navigator(config, seed, i, tick_ns, state)
