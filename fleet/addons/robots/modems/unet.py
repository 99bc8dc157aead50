"""The language of UnetStack: lines of JSON over TCP, as fjage has them, and the agents and messages of a node.

Written from the clients of others (fjagepy 2.2 and unetpy 4.1 of PyPI) and from the pages "JSON protocol" of fjage and
"Unet handbook" of UnetStack. What is answered, and what is not, is in docs/guide/modems.md.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count
from typing import Any

from fleet.addons.robots.modems.delivery import HEADER, Job
from fleet.addons.robots.modems.line_port import Client
from fleet.addons.robots.modems.modem import FIRST_OWN, ModemCore
from netem.cause import Cause
from netem.endpoint import EVERYBODY, MOST_ADDRESS, HeardFrame, SentFrame, Sound

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
CONTROL, DATA = 1, 2  # types of frames, and the indices of their parameters
_SETTABLE = {(NODE, "location"), (NODE, "address")}
_FARTHEST_M = 1e7  # from the origin
_MOST_TRIES = 3  # of the link, where the modem itself does not acknowledge
# fjagepy 2.2 drops an answer that comes before its own thread waits for it, and raises KeyError. A container in Java is
# slower than that, and so are we.
ANSWER_S = 0.02


class Unet:
    """The node of one modem."""

    delimiter = b"\n"
    link: int | None = FIRST_OWN + 1

    def __init__(self) -> None:
        self._numbers = count(1)
        self._location: list[float] | None = None  # east, north, up [m]; None: the client has set none

    def begin(self, modem: ModemCore) -> None:
        """See `ModemLanguage`."""
        self._modem = modem

    # Clients.

    def opened(self, client: Client) -> None:
        """See `Translator`."""
        client.state = frozenset[str]()  # topics and agents whose messages it wants

    def closed(self, client: Client) -> None:
        """See `Translator`."""

    def line(self, client: Client, line: bytes) -> None:
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
        self._modem.after(ANSWER_S, lambda: self._say(client, values))

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

    # Requests.

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
        handler(reply, data)

    def _clear(self, reply: _Reply, _: dict[str, Any]) -> None:
        self._modem.clear()
        reply.perform("AGREE")

    def _resolve(self, reply: _Reply, data: dict[str, Any]) -> None:
        addresses = self._modem.sea.addresses
        if (name := str(data.get("name"))) in addresses:
            address = self._modem.address if name == self._modem.sea.name else addresses[name]
            reply.tell(f"{_UNET}.addr.AddressResolutionRsp", address=address, name=name)
        else:
            reply.perform("FAILURE")

    def _range(self, reply: _Reply, data: dict[str, Any]) -> None:
        to = _whole(data.get("to"))

        def measured(range_m: float | None) -> None:
            if range_m is None:
                reply.tell(f"{_UNET}.phy.BadRangeNtf", to=to)
            else:
                reply.tell(f"{_UNET}.localization.RangeNtf", to=to, range=range_m, rxTime=self._modem.now_us)

        why = "ranges are to one node" if to in (None, EVERYBODY) else self._modem.range_to(to or 0, measured)
        reply.agree(why)

    def _frame(self, reply: _Reply, data: dict[str, Any]) -> None:
        """A frame of the modem, or a datagram of the link, which is acknowledged if it asks for that."""
        kind = CONTROL if _whole(data.get("type")) == CONTROL else DATA
        to, payload = _whole(data.get("to")) or EVERYBODY, payload_of(data.get("data"))
        what = _whole(data.get("protocol")) or 0
        reliable = reply.agent == LINK and bool(data.get("reliability")) and to != EVERYBODY

        def sent(frame: SentFrame) -> None:
            at_us, airtime_us = self._modem.us(frame.at_ns), frame.airtime_ns // 1000
            reply.tell(f"{_UNET}.phy.TxFrameNtf", txTime=at_us, type=kind, duration=airtime_us / 1000)

        def dropped(reason: str) -> None:
            reply.tell(f"{_UNET}.DatagramFailureNtf", to=to, reason=reason)

        def ends(delivered: bool) -> None:
            reply.tell(f"{_UNET}.Datagram{'Delivery' if delivered else 'Failure'}Ntf", to=to)

        if payload is None:
            reply.agree("the data are no bytes")
        elif not 0 <= what < FIRST_OWN:
            reply.agree(f"there is no protocol {what}: they are 0 to {FIRST_OWN - 1}")
        elif reliable:
            reply.agree(self._modem.deliver(Job(payload, to, what), self._tries, ends))
        else:
            reply.agree(self._modem.submit(Job(payload, to, what, sent, dropped)))

    @property
    def _tries(self) -> int:
        return self._modem.sea.modem.tries or _MOST_TRIES

    def _parameters(self, reply: _Reply, data: dict[str, Any]) -> None:
        index = _whole(data.get("index"))
        more = data.get("requests")
        asked = [one for one in [data, *(more if isinstance(more, list) else ())]
                 if isinstance(one, dict) and one.get("param")]  # fmt: skip
        values = self._values(reply.agent, -1 if index is None else index)
        for one in asked:
            name = str(one["param"]).rpartition(".")[2]
            if "value" in one and one["value"] is not None:
                self._set(reply.agent, name, one["value"])
                values = self._values(reply.agent, -1 if index is None else index)
        readonly = [name for name in values if (reply.agent, name) not in _SETTABLE]
        names = [str(one["param"]) for one in asked] or list(values)  # with the package before them, as they were asked
        found = {name: values.get(name.rpartition(".")[2]) for name in names}
        first = next(iter(names), None)
        rest = {name: value for name, value in found.items() if name != first}
        reply.tell(
            f"{_FJAGE}.param.ParameterRsp", index=-1 if index is None else index, param=first,
            value=found.get(first or ""), values=rest or None, readonly=readonly,
        )  # fmt: skip

    def _values(self, agent: str, index: int) -> dict[str, Any]:
        modem, sea = self._modem, self._modem.sea
        if agent == NODE:
            north, east, down = sea.place()[:3]
            place = self._location or [east, north, -down]
            return {"address": modem.address, "nodeName": sea.name, "addressSize": 8, "location": place,
                    "origin": [None, None], "mobility": False}  # fmt: skip
        if agent == PHYSICAL:
            rate = 8 * sea.mtu / (sea.modem.airtime_ns(sea.mtu) / 1e9)
            if index in (CONTROL, DATA):
                return {"MTU": sea.mtu, "frameLength": sea.mtu, "dataRate": rate,
                        "frameDuration": sea.modem.airtime_ns(sea.mtu) / 1e9}  # fmt: skip
            return {"MTU": sea.mtu, "RTU": sea.mtu, "busy": modem.state != "idle", "time": modem.now_us,
                    "rxEnable": True, "propagationSpeed": sea.sound_speed, "timestampedTxDelay": 0.0}  # fmt: skip
        if agent == LINK:
            return {"MTU": sea.mtu - HEADER, "RTU": sea.mtu - HEADER, "reliability": True,
                    "maxRetries": self._tries, "phy": PHYSICAL}  # fmt: skip
        return {}

    def _set(self, agent: str, name: str, value: Any) -> None:
        if (agent, name) == (NODE, "address") and EVERYBODY < (_whole(value) or 0) <= MOST_ADDRESS:
            self._modem.address = value
        elif (agent, name) == (NODE, "location") and (place := _place(value)) is not None:
            east, north, up = self._location = place
            self._modem.sea.move((north, east, -up))
        else:
            return
        changed = {name: self._values(NODE, -1)[name]}
        self._publish(f"{_UNET}.ParamChangeNtf", NODE, (PARAMETER_TOPIC,), paramValues=changed)

    # What the water says.

    def begins(self, sound: Sound) -> None:
        """See `ModemLanguage`."""
        self._publish(f"{_UNET}.phy.RxFrameStartNtf", PHYSICAL, rxTime=self._modem.us(sound.begin_ns), type=DATA)

    def heard(self, frame: HeardFrame, *, answered: bool) -> None:
        """See `ModemLanguage`."""
        data = {
            "data": {"clazz": "[B", "data": base64.b64encode(frame.payload).decode()},
            "from": frame.src, "to": frame.to, "protocol": frame.what,
            "rxTime": self._modem.us(frame.begin_ns),
        }  # fmt: skip
        if answered:
            self._publish(f"{_UNET}.DatagramNtf", LINK, (DATAGRAM_TOPIC,), **data)
        else:
            data |= {"txTime": self._modem.us(frame.sent_ns), "type": DATA}
            self._publish(f"{_UNET}.phy.RxFrameNtf", PHYSICAL, (DATAGRAM_TOPIC,), **data)

    def spoiled(self, cause: Cause, at_ns: int) -> None:
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
        self._node._tell(self._client, name, self.agent, self._to, inReplyTo=self._request, **data)

    def perform(self, performative: str) -> None:
        self.tell(f"{_FJAGE}.Message", perf=performative)

    def agree(self, why_not: str) -> None:
        """Agree, or refuse with a reason."""
        if why_not:
            self.tell(f"{_UNET}.RefuseRsp", perf="REFUSE", reason=why_not)
        else:
            self.perform("AGREE")


def _place(value: Any) -> list[float] | None:
    """Three lengths [m] that a vehicle may be at; None: it is something else."""
    if not isinstance(value, list) or len(value) != 3:
        return None
    with suppress(TypeError, ValueError, OverflowError):
        found = [float(length) for length in value]
        return found if all(abs(length) <= _FARTHEST_M for length in found) else None
    return None


def _whole(value: Any) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) else None


def payload_of(data: Any) -> bytes | None:
    """The bytes of a message: base64 or a list of numbers, signed as Java has them; None: it has none of that kind."""
    try:
        if data is None:
            return b""
        if isinstance(data, dict):
            return base64.b64decode(data.get("data") or "")
        if isinstance(data, list):
            return bytes(int(number) & 255 for number in data)
    except (ValueError, TypeError, OverflowError):
        return None
    return None
