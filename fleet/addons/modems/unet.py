"""The language of UnetStack: lines of JSON over TCP, as fjage has them, and the agents and messages of a node.

Written from the clients of others (fjagepy 2.2 and unetpy 4.1 of PyPI) and from the pages "JSON protocol" of fjage and
"Unet handbook" of UnetStack. What is answered, and what is not, is in docs/guide/modems.md.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Any

from fleet.addons.modems.delivery import CLEARED, Job
from fleet.addons.modems.fragments import MOST_PIECES, PayloadPieces
from fleet.addons.modems.line_port import Client
from fleet.addons.modems.modem import FIRST_OWN, ModemCore
from fleet.addons.modems.unet_fields import CONTROL, DATA, WrongFieldError, place_of, read_frame, read_number
from netem.cause import Cause
from netem.endpoint import EVERYBODY, MOST_ADDRESS, HeardFrame, Level, SentFrame, Sound

_UNET = "org.arl.unet"
_SERVICE = f"{_UNET}.Services."
_FJAGE = "org.arl.fjage"
DATAGRAM_TOPIC, PARAMETER_TOPIC = f"#{_UNET}.Topics.DATAGRAM", f"#{_UNET}.Topics.PARAMCHANGE"
NODE, ADDRESSES, PHYSICAL, RANGER, LINK = "node", "arp", "phy", "ranging", "uwlink"
# The first agent of a service is the one that a client gets.
SERVICES = {
    f"{_SERVICE}NODE_INFO": [NODE],
    f"{_SERVICE}ADDRESS_RESOLUTION": [ADDRESSES],
    f"{_SERVICE}PHYSICAL": [PHYSICAL],
    f"{_SERVICE}DATAGRAM": [PHYSICAL, LINK],
    f"{_SERVICE}RANGING": [RANGER],
    f"{_SERVICE}LINK": [LINK],
}
AGENTS = (NODE, ADDRESSES, PHYSICAL, RANGER, LINK)
_SETTABLE = {(NODE, "location"), (NODE, "address")}
_MOST_TRIES = 3  # of the link, where the modem itself does not acknowledge
# fjagepy 2.2 drops an answer that comes before its own thread waits for it, and raises KeyError. A container in Java is
# slower than that, and so are we.
ANSWER_S = 0.02
# It looks into its queue, and begins to wait a moment later: an answer in between is never found, and the program gets
# None after its timeout. So answers to requests leave so much later. What is requested is done at once.
REPLY_S = 0.005


class Unet:
    """The node of one modem."""

    delimiter = b"\n"
    link: int | None = FIRST_OWN + 1

    def __init__(self) -> None:
        self._numbers = count(1)
        self._location: list[float] | None = None  # east, north, up [m]; None: the client has set none
        self._fragments, self._clears = PayloadPieces(), 0

    def begin(self, modem: ModemCore) -> None:
        """See `ModemLanguage`."""
        self._modem = modem

    def on_opened(self, client: Client) -> None:
        """See `Translator`."""
        client.state = frozenset[str]()  # topics and agents whose messages it wants

    def on_partial(self, client: Client) -> None:
        """See `Translator`."""

    def on_closed(self, client: Client) -> None:
        """See `Translator`."""

    def on_line(self, client: Client, line: bytes) -> None:
        """See `Translator`. What is no JSON of fjage is dropped, as a container of fjage drops it."""
        try:
            said = json.loads(line)
        except (ValueError, RecursionError):
            return
        if not isinstance(said, dict):
            return
        if "alive" in said and "action" not in said:
            if said["alive"] is False:
                self._modem.line_port.end(client)
            return
        action, answer = said.get("action"), {"id": said.get("id"), "inResponseTo": said.get("action")}
        match action:
            case "agents":
                self._answer(
                    client, answer | {"agentIDs": list(AGENTS), "agentTypes": [f"{_UNET}.{a}" for a in AGENTS]}
                )
            case "containsAgent":
                self._answer(client, answer | {"answer": said.get("agentID") in AGENTS})
            case "services":
                self._answer(client, answer | {"services": list(SERVICES)})
            case "agentForService":
                found = SERVICES.get(str(said.get("service")))
                self._answer(client, answer | ({"agentID": found[0]} if found else {}))
            case "agentsForService":
                self._answer(client, answer | {"agentIDs": SERVICES.get(str(said.get("service")), [])})
            case "wantsMessagesFor":
                wanted = said.get("agentIDs")
                client.state = frozenset(map(str, wanted[:1000] if isinstance(wanted, list) else ()))
            case "send":
                self._take(client, said.get("message"))

    def _answer(self, client: Client, values: Mapping[str, Any]) -> None:
        self._modem.call_after(ANSWER_S, lambda: self._say(client, values))

    def _say(self, client: Client, values: Mapping[str, Any]) -> None:
        self._modem.line_port.say(client, json.dumps(values).encode() + b"\n")

    def _tell(self, client: Client, name: str, agent: str, to: str, /, **data: Any) -> None:
        """Send a client a message of an agent."""
        whole = {"msgID": f"{self._modem.number}-{next(self._numbers)}", "perf": "INFORM", "sender": agent}
        message = {"clazz": name, "data": whole | {"recipient": to} | data}
        self._say(client, {"id": whole["msgID"], "action": "send", "message": message, "relay": False})

    def _publish(self, name: str, agent: str, topics: tuple[str, ...] = (), /, **data: Any) -> None:
        """Send a message to each client that listens, once, whatever number of its topics it listens to."""
        for client in list(self._modem.line_port.clients):
            for topic in (*topics, f"#{agent}__ntf", f"#{agent}"):
                if topic in client.state:
                    self._tell(client, name, agent, topic, **data)
                    break

    def _take(self, client: Client, message: Any) -> None:
        data = message.get("data") if isinstance(message, dict) else None
        if not isinstance(data, dict):
            return
        agent, kind = str(data.get("recipient")), str(message.get("clazz")).rpartition(".")[2]
        reply = _Reply(self, client, agent, data)
        if agent not in AGENTS:
            return  # as a container does with a message for an agent that is not there
        handlers: dict[tuple[str, str], Callable[[_Reply, dict[str, Any]], None]] = {
            (PHYSICAL, "DatagramReq"): self._frame,
            (PHYSICAL, "TxFrameReq"): self._frame,
            (PHYSICAL, "ClearReq"): self._clear,
            (LINK, "DatagramReq"): self._frame,
            (RANGER, "RangeReq"): self._range,
            (ADDRESSES, "AddressResolutionReq"): self._resolve,
        }
        handler = self._parameters if kind == "ParameterReq" else handlers.get((agent, kind))
        if handler is None:
            reply.perform("NOT_UNDERSTOOD")
            return
        try:
            handler(reply, data)
        except WrongFieldError as error:
            reply.agree(str(error))

    def _clear(self, reply: _Reply, _: dict[str, Any]) -> None:
        self._clears += 1
        self._modem.clear()
        reply.perform("AGREE")

    def _resolve(self, reply: _Reply, data: dict[str, Any]) -> None:
        addresses = self._modem.channel.addresses
        found: dict[str, Any] = {"perf": "FAILURE", "address": None}
        if (name := str(data.get("name"))) in addresses:
            address = self._modem.address if name == self._modem.channel.name else addresses[name]
            found = {"address": address}
        # `host` of unetpy 4.1 reads the address of any answer, and raises AttributeError at one without.
        reply.tell(f"{_UNET}.addr.AddressResolutionRsp", name=name, **found)

    def _range(self, reply: _Reply, data: dict[str, Any]) -> None:
        to = read_number(data, "to")

        def measured(range_m: float | None) -> None:
            if range_m is None:
                reply.tell(f"{_UNET}.phy.BadRangeNtf", to=to)
            else:
                reply.tell(f"{_UNET}.localization.RangeNtf", to=to, range=range_m, rxTime=self._modem.now_us)

        why = "ranges are to one node" if to in (None, EVERYBODY) else self._modem.range_to(to or 0, measured)
        reply.agree(why)

    def _frame(self, reply: _Reply, data: dict[str, Any]) -> None:
        """A frame of the modem, or a datagram of the link, which is acknowledged if it asks for that."""
        modem, frame = self._modem, read_frame(data)

        def sent(begun: SentFrame) -> None:
            at_us, airtime_us = modem.us(begun.at_ns), begun.airtime_ns // 1000
            reply.tell(f"{_UNET}.phy.TxFrameNtf", txTime=at_us, type=frame.kind, duration=airtime_us / 1000)

        def dropped(reason: str) -> None:
            reply.tell(f"{_UNET}.DatagramFailureNtf", to=frame.to, reason=reason)

        def ends(answer: HeardFrame | None) -> None:
            reply.tell(f"{_UNET}.Datagram{'Failure' if answer is None else 'Delivery'}Ntf", to=frame.to)

        job = Job(frame.payload, frame.to, frame.what, sent, dropped)
        if reply.agent == PHYSICAL:
            timed = frame.at_us is not None
            # A time that is past is refused, which is an assumption: the handbook says that frames may have a time.
            reply.agree(modem.submit_at(job, modem.at_ns(frame.at_us or 0)) if timed else modem.submit(job))
        elif frame.at_us is not None:
            reply.agree(f"{LINK} sends when it can: a frame with a txTime goes to {PHYSICAL}")
        elif len(frame.payload) > self._longest:
            reply.agree(f"{len(frame.payload)} bytes are more than the MTU of {self._longest}")
        else:
            self._send_pieces(reply, job, ends if frame.reliable and frame.to != EVERYBODY else None)

    @property
    def _longest(self) -> int:
        """Bytes of the longest datagram of the link, which cuts it into frames as that of UnetStack does."""
        return MOST_PIECES * self._modem.channel.mtu

    def _send_pieces(self, reply: _Reply, whole: Job, ends: Callable[[HeardFrame | None], None] | None) -> None:
        """Send a datagram of the link, one piece after the other. `ends` learns whether all are acknowledged; None:
        they need not be."""
        modem, began, pieces, turn = (
            self._modem,
            list[SentFrame](),
            self._fragments.split(whole.payload, self._modem.channel.mtu),
            self._clears,
        )

        def send(number: int) -> str:
            head, data = pieces[number]
            job = replace(whole, payload=data, head=head, on_sent=partial(sent, number))
            if ends is None:
                job = modem.unacknowledged(job)
                return modem.go_on(job) if number else modem.submit(job)
            job.on_sent, job.on_dropped = lambda _: None, lambda _: None
            return modem.deliver(job, self._tries, partial(answered, number), goes_on=number > 0)

        def sent(number: int, frame: SentFrame) -> None:
            began.append(frame)
            if number + 1 == len(pieces):  # it is told when all of it is on its way
                whole.on_sent(began[0]._replace(airtime_ns=sum(each.airtime_ns for each in began)))
            elif self._clears == turn:
                send(number + 1)
            else:
                whole.on_dropped(CLEARED)

        def answered(number: int, answer: HeardFrame | None) -> None:
            assert ends is not None
            last = number + 1 == len(pieces)
            if answer is None or last or self._clears != turn:
                ends(answer if last else None)
            elif send(number + 1):
                ends(None)

        reply.agree(send(0))

    @property
    def _tries(self) -> int:
        return self._modem.channel.modem.tries or _MOST_TRIES

    def _parameters(self, reply: _Reply, data: dict[str, Any]) -> None:
        number = read_number(data, "index")
        index, more = -1 if number is None else number, data.get("requests")
        asked = [one for one in [data, *(more if isinstance(more, list) else ())]
                 if isinstance(one, dict) and one.get("param")]  # fmt: skip
        wanted = {str(one["param"]).rpartition(".")[2]: one["value"] for one in asked if one.get("value") is not None}
        values = self._values(reply.agent, index)
        if unknown := [name for name in wanted if name not in values]:
            # Not in silence: `unetpy` drops the answer to an assignment, so the result of the run tells it, too.
            whose = reply.agent if index < 0 else f"{reply.agent}[{index}]"
            self._modem.remark_once(f"its program set {whose}.{unknown[0]:.32}, which is no parameter of it")
            reply.agree(f"{whose} has no parameter {', '.join(unknown):.200}; it has {', '.join(values) or 'none'}")
            return
        for name, value in wanted.items():
            self._set(reply.agent, name, value)
        values = self._values(reply.agent, index)
        readonly = [name for name in values if (reply.agent, name) not in _SETTABLE]
        names = [str(one["param"]) for one in asked] or list(values)  # with the package before them, as they were asked
        values |= {"name": reply.agent}  # each agent has it, and none lists it
        found = {name: values.get(name.rpartition(".")[2]) for name in names}
        first = next(iter(names), None)
        rest = {name: value for name, value in found.items() if name != first}
        reply.tell(
            f"{_FJAGE}.param.ParameterRsp", index=index, param=first,
            value=found.get(first or ""), values=rest or None, readonly=readonly,
        )  # fmt: skip

    def _values(self, agent: str, index: int) -> dict[str, Any]:
        modem, channel = self._modem, self._modem.channel
        if agent == NODE:
            north, east, down = channel.place()[:3]
            place = self._location or [east, north, -down]
            return {"address": modem.address, "nodeName": channel.name, "addressSize": 8, "location": place,
                    "origin": [None, None], "mobility": False}  # fmt: skip
        if agent == PHYSICAL:
            rate = 8 * channel.mtu / (channel.modem.airtime_ns(channel.mtu) / 1e9)
            if index in (CONTROL, DATA):
                return {"MTU": channel.mtu, "frameLength": channel.mtu, "dataRate": rate,
                        "frameDuration": channel.modem.airtime_ns(channel.mtu) / 1e9}  # fmt: skip
            if index != -1:
                return {}
            return {"MTU": channel.mtu, "RTU": channel.mtu, "busy": modem.state != "idle", "time": modem.now_us,
                    "rxEnable": True, "propagationSpeed": channel.sound_speed, "timestampedTxDelay": 0.0}  # fmt: skip
        if agent == LINK:
            return {"MTU": self._longest, "RTU": self._longest, "reliability": True,
                    "maxRetries": self._tries, "phy": PHYSICAL}  # fmt: skip
        return {}

    def _set(self, agent: str, name: str, value: Any) -> None:
        if (agent, name) == (NODE, "address") and _is_address(value):
            self._modem.address = value
        elif (agent, name) == (NODE, "location") and (place := place_of(value)) is not None:
            east, north, up = self._location = place
            self._modem.channel.move((north, east, -up))
        else:
            return
        changed = {name: self._values(NODE, -1)[name]}
        self._publish(f"{_UNET}.ParamChangeNtf", NODE, (PARAMETER_TOPIC,), paramValues=changed)

    def on_pinged(self, frame: HeardFrame) -> None:
        """See `ModemLanguage`. Its language has no word for it."""

    def begins(self, sound: Sound) -> None:
        """See `ModemLanguage`."""
        self._publish(f"{_UNET}.phy.RxFrameStartNtf", PHYSICAL, rxTime=self._modem.us(sound.begin_ns), type=DATA)

    def on_heard(self, frame: HeardFrame, *, linked: bool) -> None:
        """See `ModemLanguage`. A frame of the modem is a RxFrameNtf, which is a DatagramNtf with more in it."""
        if (payload := self._fragments.join(frame) if linked else frame.payload) is None:
            return
        data = {
            "data": {"clazz": "[B", "data": base64.b64encode(payload).decode()},
            "from": frame.src, "to": frame.to, "protocol": frame.what,
            "rxTime": self._modem.us(frame.begin_ns), "txTime": self._modem.us(frame.sent_ns),
        }  # fmt: skip
        if linked:
            self._publish(f"{_UNET}.DatagramNtf", LINK, (DATAGRAM_TOPIC,), **data)
        else:
            self._publish(f"{_UNET}.phy.RxFrameNtf", PHYSICAL, (DATAGRAM_TOPIC,), **data, type=DATA)

    def on_spoiled(self, cause: Cause, at_ns: int, level: Level) -> None:
        """See `ModemLanguage`."""
        at_us = self._modem.us(at_ns)
        self._publish(f"{_UNET}.phy.BadFrameNtf", PHYSICAL, rxTime=at_us, type=DATA)
        if cause is Cause.COLLISION:
            self._publish(f"{_UNET}.phy.CollisionNtf", PHYSICAL, rxTime=at_us, type=DATA)


class _Reply:
    """Where the answers to a request go."""

    def __init__(self, node: Unet, client: Client, agent: str, data: Mapping[str, Any]) -> None:
        self._node, self._client, self.agent = node, client, agent
        self._to, self._request = str(data.get("sender")), data.get("msgID")

    def tell(self, name: str, /, **data: Any) -> None:
        whole = data | {"inReplyTo": self._request}
        say = partial(self._node._tell, self._client, name, self.agent, self._to, **whole)
        self._node._modem.call_after(REPLY_S, say)

    def perform(self, performative: str) -> None:
        self.tell(f"{_FJAGE}.Message", perf=performative)

    def agree(self, why_not: str) -> None:
        """Agree, or refuse with a reason."""
        if why_not:
            self.tell(f"{_UNET}.RefuseRsp", perf="REFUSE", reason=why_not)
        else:
            self.perform("AGREE")


def _is_address(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and EVERYBODY < value <= MOST_ADDRESS
