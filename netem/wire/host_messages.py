"""The messages of a process that hosts several agents: theirs, many in one, and that one has ended."""

from __future__ import annotations

from typing import Annotated, ClassVar

from netem.wire.declaring import Route, Uint, WireRecord, about


class BundlePart(WireRecord, frozen=True):
    """A message of, or for, one of several agents that share a process."""

    vehicle: Annotated[Uint, about("vehicle number")]
    message: Annotated[bytes, about("one that would travel on the agent's own key")]


class Bundle(WireRecord, frozen=True, tag="bundle"):
    """Messages of several agents that share a process, in one put. You never get it."""

    route: ClassVar[Route] = Route(
        "host/{h}, cmd/host-{h}, tx/host-{h}", "world and netem, host h", "host h, world, netem"
    )

    parts: Annotated[tuple[BundlePart, ...], about("those of one agent in their order")]


class Ended(WireRecord, frozen=True, tag="ended"):
    """One of several agents that share a process has ended; the others continue."""

    route: ClassVar[Route] = Route("note/host-{h}", "host h", "console")

    vehicle: Annotated[Uint, about("vehicle number")]
    status: Annotated[Uint, about("with which a process of its own would have ended")]
