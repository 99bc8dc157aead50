"""A modem whose water is that of a run in lockstep: what it sends are payloads of its agent, who hands it its news."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from msgspec import MsgspecError

from fleet.addons.modems.modem import ModemCore
from netem.endpoint import ModemChannel, ModemRequest
from netem.lockstep_modems import read_news
from netem.modem_frame import NEWS, SWITCH_ON, ModemFrame, read_frame
from netem.modem_news import FrameArrived, News, SwitchedOn, tell

Place = tuple[float, ...]


class AgentModem:
    """The modem of one agent."""

    def __init__(
        self,
        modem: ModemCore,
        name: str,
        addresses: Mapping[str, int],
        begin_ns: int,
        send: Callable[[bytes], object],
    ) -> None:
        """Switch it on: it serves its programs when the water has answered.

        Args:
            modem: it, whose port is open.
            name: of the agent's vehicle.
            addresses: of all modems, by name of the vehicle.
            begin_ns: t = 0 [ns, CLOCK_MONOTONIC].
            send: takes payloads of the agent; called on the thread of the modem's port, too.
        """
        self._modem, self._name, self._addresses, self._begin_ns = modem, name, dict(addresses), begin_ns
        self._send = send
        self._place: Place = (0.0, 0.0, 0.0)
        self._arrives: dict[tuple[int, int, int], FrameArrived] = {}  # what is known of payloads that come next
        self._begun = False
        send(SWITCH_ON)

    def hear(self, src: int, seq: int, copy: int, payload: bytes, place: Place) -> None:
        """Take a payload that has reached the agent.

        Args:
            src, seq, copy: its sender, its number and that of its copy; news have the agent itself as their sender.
            payload: the payload; what is neither news nor a frame is ignored.
            place: where the vehicle is [m, NED].
        """
        self._place = place
        if payload.startswith(NEWS) and src == self._modem.number:
            self._arrives = {}
            try:
                news = read_news(payload)
            except MsgspecError:
                return
            for event in news:
                self._learn(event)
        elif (arrives := self._arrives.pop((src, seq, copy), None)) and (frame := read_frame(payload)):
            heard = arrives.frame(frame.src, frame.to, frame.what, frame.payload, frame.head, self._begin_ns)
            self._modem.on_heard(heard)

    def _learn(self, event: News) -> None:
        match event:
            case SwitchedOn():
                if not self._begun:
                    self._begun = True
                    self._modem.begin(self._channel(event))
            case FrameArrived():
                self._arrives[event.src, event.seq, event.copy] = event
            case _:
                tell(self._modem, event, self._begin_ns)

    def _channel(self, station: SwitchedOn) -> ModemChannel:
        return ModemChannel(
            station.modem, station.mtu, station.queue, station.access_s, station.sound_speed, self._begin_ns,
            station.seed, self._name, {**self._addresses, self._name: self._modem.address}, self._transmit,
            lambda: self._place, self._cannot_move,
        )  # fmt: skip

    def _transmit(self, request: ModemRequest) -> None:
        at_ns = None if request.at_ns is None else request.at_ns - self._begin_ns
        to, what = request.to, request.what
        self._send(ModemFrame(request.tag, request.src, to, what, request.payload, request.head, at_ns).packed())

    def _cannot_move(self, _: Any) -> None:
        self._modem.remark_once("a program said where its modem is: here a vehicle is where the run has it")
