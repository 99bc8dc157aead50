"""The modem of one vehicle on the acoustic channel: what waits in it, and what it is working on."""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from netem.cause import Cause

ANSWER = -1  # the `copy` of a reception that is an acknowledgement
REQUEST, REPLY = -2, -3  # the `copy` of a reception of two-way ranging


class QueuedPayload(NamedTuple):
    """A payload that is not yet transmitted.

    `sent_tick` is the round tick of the payload; at `ready_tick` it enters the modem (later if the agent is slow).
    """

    ready_tick: int
    seq: int
    sent_tick: int
    payload: bytes


class Station(Struct, array_like=True):
    """The modem of one vehicle: its transmit buffer, the payloads still on their way to it, and its next start."""

    vehicle: int
    late: list[QueuedPayload] = []  # not yet in the modem, in order of ready_tick
    waiting: list[QueuedPayload] = []  # the transmit buffer, oldest first
    start_tick: int | None = None  # when the first payload in the buffer starts; None: the buffer is empty
    free_tick: int = 0  # first tick at which the modem can start again
    seq: int = 0  # number of payloads taken from the agent so far
    draws: int = 0  # number of random back-offs used so far
    timed: list[tuple[int, QueuedPayload]] = []  # payloads with a start tick that is asked for, the first one first

    @property
    def unsent(self) -> tuple[QueuedPayload, ...]:
        """The payloads that it has not transmitted."""
        return (*self.late, *self.waiting, *(sent for _, sent in self.timed))


class Transfer(Struct, array_like=True):
    """A payload that a modem sends to one neighbour after the other, until each has acknowledged it."""

    sent: QueuedPayload
    to: list[int]  # neighbours to whom it is still sent; the first is addressed now
    tried: int = 0  # transmissions to the first neighbour so far
    deadline_tick: int = 0  # when the last transmission counts as failed
    arrived: bool = False  # the first neighbour has the payload
    cause: Cause | None = None  # why the last try to the first failed

    def missing(self) -> list[int]:
        return self.to[1:] if self.arrived else self.to


class Answer(NamedTuple):
    """An acknowledgement that a receiver sends at `start_tick`."""

    start_tick: int
    src: int  # who received the payload
    dst: int  # who sent it
    seq: int


class Burst(NamedTuple):
    """A transmission. `heard`: vehicles within the interference range, as (vehicle, range [m], propagation [ns])."""

    start_tick: int
    src: int
    airtime_ns: int
    heard: tuple[tuple[int, float, int], ...]


class Reception(NamedTuple):
    """A transmission as one graph neighbour `dst` of the sender receives it, from `begin_ns` to `end_ns`.

    `extra_ns` is the delay that the link's condition adds after `end_ns`; `copy` is 0, or 1 and more for duplicates.
    """

    begin_ns: int
    end_ns: int
    start_tick: int
    range_m: float
    extra_ns: int
    src: int
    dst: int
    seq: int
    copy: int
    sent_tick: int
    payload: bytes
    corrupted: bool
