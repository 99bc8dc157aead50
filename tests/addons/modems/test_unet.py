"""A modem in the language of UnetStack: canned dialogues, with a sea that keeps what it is given."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from time import monotonic_ns
from typing import Any

import pytest
from modem_water import LIMIT_S, SPEED, ModemClient, Water
from waiting import wait_for

from fleet.addons.modems.modem import RANGING
from fleet.addons.modems.unet import DATAGRAM_TOPIC, PARAMETER_TOPIC, Unet
from netem.cause import Cause
from netem.endpoint import SentFrame, Sound

UNET = "org.arl.unet"


class Program(ModemClient):
    """A client of fjage, as far as bytes go."""

    def say(self, **values: Any) -> None:
        self.socket.sendall(json.dumps(values).encode() + b"\n")

    def hears(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.file.readline())
        return found

    def asks(self, action: str, **values: Any) -> dict[str, Any]:
        self.say(id="1", action=action, **values)
        return self.hears()

    def requests(self, kind: str, recipient: str, **data: Any) -> None:
        whole = {"msgID": "m1", "perf": "REQUEST", "recipient": recipient, "sender": "me"} | data
        self.say(id="2", action="send", relay=True, message={"clazz": kind, "data": whole})

    def message(self) -> tuple[str, dict[str, Any]]:
        """The next message: its class without its package, and its data."""
        found = self.hears()["message"]
        return found["clazz"].rpartition(".")[2], found["data"]

    def get(self, agent: str, name: str, index: int = -1) -> Any:
        self.requests("org.arl.fjage.param.ParameterReq", agent, param=name, index=index)
        kind, data = self.message()
        assert kind == "ParameterRsp" and data["inReplyTo"] == "m1" and data["param"] == name
        return data["value"]


@pytest.fixture
def water() -> Iterator[Water]:
    with closing(Water(Unet)) as found:
        yield found


@pytest.fixture
def program(water: Water) -> Iterator[Program]:
    with closing(Program(water.port)) as found:
        yield found


def test_the_container_answers(program: Program) -> None:
    assert program.asks("agentForService", service=f"{UNET}.Services.PHYSICAL") == {
        "id": "1", "inResponseTo": "agentForService", "agentID": "phy",
    }  # fmt: skip
    assert "agentID" not in program.asks("agentForService", service=f"{UNET}.Services.BASEBAND")
    assert program.asks("agentsForService", service=f"{UNET}.Services.DATAGRAM")["agentIDs"] == ["phy", "uwlink"]
    assert program.asks("containsAgent", agentID="ranging")["answer"] is True
    assert program.asks("containsAgent", agentID="shell")["answer"] is False
    assert "node" in program.asks("agents")["agentIDs"]
    assert f"{UNET}.Services.LINK" in program.asks("services")["services"]


def test_parameters_that_programs_read(program: Program, water: Water) -> None:
    assert (program.get("node", "address"), program.get("node", "nodeName")) == (1, "auv1")
    assert program.get("node", "location") == [20.0, 10.0, -5.0]  # east, north, up
    assert (program.get("phy", "MTU"), program.get("phy", "propagationSpeed")) == (64, SPEED)
    assert program.get("phy", "dataRate", index=2) == pytest.approx(800.0)
    assert program.get("phy", f"{UNET}.phy.PhysicalParam.busy") is False
    assert program.get("phy", "name") == "phy"  # unetjs asks for it
    assert program.get("uwlink", "MTU") == 64 * 64
    program.requests("org.arl.fjage.param.ParameterReq", "node", param="location", value=[3.0, 4.0, -7.0])
    assert program.message()[1]["value"] == [3.0, 4.0, -7.0]
    assert water.moved == [(4.0, 3.0, 7.0)]


def test_an_address_may_change_and_what_is_for_others_is_not_heard(program: Program, water: Water) -> None:
    program.say(action="wantsMessagesFor", agentIDs=[DATAGRAM_TOPIC, PARAMETER_TOPIC])
    program.requests("org.arl.fjage.param.ParameterReq", "node", param="address", value=9)
    kind, data = program.message()
    assert (kind, data["paramValues"]) == ("ParamChangeNtf", {"address": 9})
    assert program.message()[1]["value"] == 9
    water.brings(2, b"for others", to=1, left=1.0, came=1.1)
    water.brings(2, b"for it", to=9, left=2.0, came=2.1)
    water.brings(2, b"for all", to=0, left=3.0, came=3.1)
    told = [base64.b64decode(program.message()[1]["data"]["data"]) for _ in range(2)]
    assert told == [b"for it", b"for all"]
    program.requests(f"{UNET}.DatagramReq", "phy", to=27)  # nobody has it, which a modem cannot know
    assert program.message()[1]["perf"] == "AGREE" and water.next()[1:3] == (9, 27)


@pytest.mark.parametrize(
    ("name", "value"),
    [("address", 0), ("address", 256), ("address", "9"), ("location", [1.0, 2.0]), ("location", [1.0, "x", None]),
     ("location", [float("nan"), 0.0, 0.0]), ("location", [0.0, float("inf"), 0.0]), ("location", [1e300, 0.0, 0.0])],
)  # fmt: skip
def test_a_value_that_cannot_be_leaves_the_parameter(program: Program, water: Water, name: str, value: Any) -> None:
    before = program.get("node", name)
    program.requests("org.arl.fjage.param.ParameterReq", "node", param=name, value=value)
    assert program.message()[1]["value"] == before and not water.moved


def test_a_datagram_leaves_and_its_sender_is_told(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.DatagramReq", "phy", to=2, protocol=32, data=[1, -1, 200])
    assert program.message()[1]["perf"] == "AGREE"
    request = water.sends(at_s=1.5)
    assert (request.to, request.what, request.payload) == (2, 32, b"\x01\xff\xc8")
    kind, data = program.message()
    assert (kind, data["txTime"], data["inReplyTo"]) == ("TxFrameNtf", 1_500_000, "m1")


def test_a_broadcast_has_no_address_and_data_may_be_base64(program: Program, water: Water) -> None:
    data = {"clazz": "[B", "data": base64.b64encode(b"hello").decode()}
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", data=data)
    request = water.next()
    assert (request.to, request.payload) == (0, b"hello")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ({"data": [0] * 65}, "more than the MTU of 64"),
        ({"data": "text"}, "are no bytes"),
        ({"protocol": 64}, "no protocol 64"),
        ({"to": 256}, "there is no address 256: they are 1 to 255"),
    ],
)
def test_what_cannot_be_sent_is_refused_with_a_reason(program: Program, data: dict[str, Any], reason: str) -> None:
    program.requests(f"{UNET}.DatagramReq", "phy", **data)
    kind, said = program.message()
    assert (kind, said["perf"]) == ("RefuseRsp", "REFUSE") and reason in said["reason"]


def test_a_frame_with_a_time_begins_then(program: Program, water: Water) -> None:
    """It is given to the channel shortly before, and what waits for its turn goes by."""
    at_us = program.get("phy", "time") + 300_000
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=at_us)
    program.requests(f"{UNET}.DatagramReq", "phy", to=2, data=[2])
    assert [program.message()[1]["perf"] for _ in range(2)] == ["AGREE"] * 2
    assert water.next().payload == b"\x02"
    request = water.next()
    assert (request.payload, request.at_ns) == (b"\x01", water.begin_ns + at_us * 1000)
    water.core.on_sent(SentFrame(request.tag, request.at_ns or 0, 100_000_000))
    kind, data = program.message()
    assert (kind, data["txTime"]) == ("TxFrameNtf", at_us)


def test_a_time_that_cannot_be_kept_is_refused_or_told(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=1)
    kind, data = program.message()
    assert kind == "RefuseRsp" and data["reason"].startswith("the time is past: it is ")
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[1], txTime=10**9)
    assert "goes to phy" in program.message()[1]["reason"]
    for _ in range(3):
        program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=10**12)
    assert [program.message()[1]["perf"] for _ in range(3)] == ["AGREE", "AGREE", "REFUSE"]
    program.requests(f"{UNET}.ClearReq", "phy")
    assert [program.message()[1].get("reason") for _ in range(3)] == ["cleared", "cleared", None]
    at_us = program.get("phy", "time") + 60_000
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=at_us)
    assert program.message()[1]["perf"] == "AGREE"
    water.core.on_dropped(water.next().tag, Cause.QUEUE)
    assert program.message()[1]["reason"] == "the modem was still sending something else at that time"


def test_a_time_that_is_years_away_keeps_the_modem_alive(program: Program, water: Water) -> None:
    """And what is cleared leaves nothing behind."""
    for _ in range(3):
        program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=10**19)
        assert program.message()[1]["perf"] == "AGREE"
        program.requests(f"{UNET}.ClearReq", "phy")
        assert [program.message()[1].get("reason") for _ in range(2)] == ["cleared", None]
    assert program.asks("containsAgent", agentID="phy")["answer"] is True
    program.requests(f"{UNET}.DatagramReq", "phy", to=2, data=[2])
    assert program.message()[1]["perf"] == "AGREE" and water.next().payload == b"\x02"
    assert len(water.core._alarms) <= 1


def test_a_modem_with_tries_keeps_no_time(program: Program, water: Water) -> None:
    water.core.channel = water.core.channel._replace(modem=replace(water.core.channel.modem, tries=3))
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", to=2, data=[1], txTime=10**12)
    assert "begins at no time" in program.message()[1]["reason"]


@pytest.mark.parametrize(("to", "address"), [("2", 2), (2.0, 2), (2, 2), (0, 0), (None, 0)])
def test_an_address_is_what_is_clearly_a_number(program: Program, water: Water, to: Any, address: int) -> None:
    """Else a message for one goes to all."""
    for agent in ("phy", "uwlink"):
        program.requests(f"{UNET}.DatagramReq", agent, to=to, protocol="32", data=[1])
        assert program.message()[1]["perf"] == "AGREE"
        assert water.sends().to == address and program.message()[0] == "TxFrameNtf"


@pytest.mark.parametrize(
    ("field", "value"),
    [("to", "two"), ("to", 2.5), ("to", True), ("to", [2]), ("to", ""), ("to", "9" * 5000), ("to", float("nan")),
     ("to", float("inf")), ("protocol", "data"), ("type", {}), ("txTime", "now")],
)  # fmt: skip
def test_what_is_no_number_is_refused_and_nothing_is_sent(
    program: Program, water: Water, field: str, value: Any
) -> None:
    program.requests(f"{UNET}.phy.TxFrameReq", "phy", **{"data": [1], field: value})
    kind, data = program.message()
    assert kind == "RefuseRsp" and data["reason"].startswith(f"{field} is a whole number, got ")
    program.requests(f"{UNET}.localization.RangeReq", "ranging", to=value)
    assert program.message()[0] == "RefuseRsp" and not water.given


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [("type", 3, "no frame type 3"), ("reliability", "yes", "reliability is true or false, got 'yes'")],
)
def test_a_field_without_such_a_value_is_refused(program: Program, field: str, value: Any, reason: str) -> None:
    program.requests(f"{UNET}.DatagramReq", "uwlink", **{"data": [1], field: value})
    assert reason in program.message()[1]["reason"]


@pytest.mark.parametrize(("agent", "index", "name"), [("phy", -1, "powerLevel"), ("phy", 3, "MTU"), ("arp", -1, "x")])
def test_a_parameter_that_does_not_exist_is_not_set_in_silence(
    program: Program, water: Water, agent: str, index: int, name: str
) -> None:
    """The answer says so, and the result of the run, since a client may drop the answer."""
    kind = "org.arl.fjage.param.ParameterReq"
    program.requests(kind, agent, param=name, value=5, index=index)
    whose = agent if index < 0 else f"{agent}[{index}]"
    assert program.message()[1]["reason"].startswith(f"{whose} has no parameter {name}; it has ")
    assert water.core.remark == f"its program set {whose}.{name}, which is no parameter of it"
    assert program.get(agent, name, index) is None  # a question is answered, as before


def test_one_unknown_parameter_of_several_sets_none(program: Program, water: Water) -> None:
    more = [{"param": "nothing", "value": 1}]
    kind = "org.arl.fjage.param.ParameterReq"
    program.requests(kind, "node", param="location", value=[3.0, 4.0, -7.0], requests=more)
    assert program.message()[0] == "RefuseRsp" and not water.moved


def test_datagrams_wait_in_order_and_a_full_queue_refuses(program: Program, water: Water) -> None:
    """One is in the channel, and two wait; `ClearReq` forgets these."""
    for number in range(4):
        program.requests(f"{UNET}.DatagramReq", "phy", data=[number])
    assert [program.message()[1]["perf"] for _ in range(4)] == ["AGREE", "AGREE", "AGREE", "REFUSE"]
    assert water.core.remark == "its modem refused 1 payload, since 2 were waiting"
    assert [water.sends().payload for _ in range(2)] == [b"\x00", b"\x01"]
    assert [program.message()[0] for _ in range(2)] == ["TxFrameNtf"] * 2
    program.requests(f"{UNET}.ClearReq", "phy")
    assert program.message()[1]["perf"] == "AGREE"


def test_a_datagram_that_the_water_refuses_is_told(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.DatagramReq", "phy", to=2, data=[1])
    assert program.message()[1]["perf"] == "AGREE"
    tag = water.next().tag
    for _ in range(2):  # one loss per receiver
        water.core.on_dropped(tag, Cause.MUTE)
    kind, data = program.message()
    assert (kind, data["to"], data["reason"]) == ("DatagramFailureNtf", 2, "mute")


@pytest.mark.parametrize("topic", [DATAGRAM_TOPIC, "#phy__ntf", "#phy"])
def test_who_listens_hears_once_with_times(program: Program, water: Water, topic: str) -> None:
    program.say(action="wantsMessagesFor", agentIDs=[topic, DATAGRAM_TOPIC])
    program.asks("services")  # it has been read
    water.brings(2, b"hi", left=2.0, came=2.5, what=32)
    water.core.on_spoiled(Cause.COLLISION, water.at(3.0))
    kind, data = program.message()
    assert kind == "RxFrameNtf" and base64.b64decode(data["data"]["data"]) == b"hi"
    assert (data["from"], data["to"], data["protocol"]) == (2, 1, 32)
    assert (data["txTime"], data["rxTime"]) == (2_000_000, 2_500_000)
    if topic != DATAGRAM_TOPIC:
        assert [program.message()[0] for _ in range(2)] == ["BadFrameNtf", "CollisionNtf"]


def test_a_range_is_half_of_the_travel_without_the_turn_around(program: Program, water: Water) -> None:
    """It leaves at 1 s, travels 0.4 s, is answered after 3 s, and comes back after 0.4 s: 600 m."""
    program.requests(f"{UNET}.localization.RangeReq", "ranging", to=2)
    assert program.message()[1]["perf"] == "AGREE"
    request = water.sends(at_s=1.0)
    assert (request.to, request.what) == (2, RANGING)
    answer = request.payload + round(1.4e9).to_bytes(8, "little")
    water.brings(2, answer, what=RANGING, left=4.4, came=4.8)
    kind, data = program.message()
    assert (kind, data["to"]) == ("RangeNtf", 2) and data["range"] == pytest.approx(600.0)


def test_two_ranges_at_a_time_are_not_mixed_up(program: Program, water: Water) -> None:
    """A node at 600 m: the second request leaves 0.3 s later, and the answers come in turn."""
    for _ in range(2):
        program.requests(f"{UNET}.localization.RangeReq", "ranging", to=2)
        assert program.message()[1]["perf"] == "AGREE"
    asked = [water.sends(at_s=at) for at in (1.0, 1.3)]
    for request, came, left in zip(asked, (1.4, 1.7), (2.0, 4.0), strict=True):
        answer = request.payload + round(came * 1e9).to_bytes(8, "little")
        water.brings(2, answer, what=RANGING, left=left, came=left + 0.4)
    assert [program.message()[1]["range"] for _ in range(2)] == pytest.approx([600.0, 600.0])


def test_a_request_of_ranging_is_answered_with_when_it_came(water: Water) -> None:
    water.brings(3, b"\7", what=RANGING, left=1.0, came=2.0)
    request = water.next()
    assert (request.to, request.payload) == (3, b"\7" + round(2.0e9).to_bytes(8, "little"))


def test_the_link_acknowledges_and_tries_again(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, protocol=32, data=[7], reliability=True)
    assert program.message()[1]["perf"] == "AGREE"
    request = water.sends()
    kind, number, what = request.head
    assert (request.what, kind, what, request.payload) == (Unet.link, 1, 32, b"\x07")
    water.brings(2, b"", head=bytes((0, number, what)), what=Unet.link, left=2.0, came=2.2)
    kind, data = program.message()
    assert (kind, data["to"]) == ("DatagramDeliveryNtf", 2)


def test_a_datagram_of_the_link_is_one_of_the_link_where_it_arrives(program: Program, water: Water) -> None:
    """Also without an acknowledgement: programs that listen to the link alone hear it."""
    program.say(action="wantsMessagesFor", agentIDs=["#uwlink__ntf"])
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, protocol=32, data=[7])
    assert program.message()[1]["perf"] == "AGREE"
    request = water.sends(at_s=1.5)
    assert program.message()[0] == "TxFrameNtf"  # for programs that wait until it has left
    water.brings(2, request.payload, head=request.head, what=request.what, left=1.5, came=1.7)
    kind, data = program.message()
    assert (kind, data["sender"], data["protocol"]) == ("DatagramNtf", "uwlink", 32)
    assert (data["txTime"], data["rxTime"]) == (1_500_000, 1_700_000)
    assert program.asks("containsAgent", agentID="phy")["answer"] is True and not water.given  # no acknowledgement


@pytest.mark.parametrize("reliability", [True, False])
@pytest.mark.parametrize("agent", ["phy", "uwlink"])
def test_a_payload_beyond_the_mtu_is_refused(program: Program, water: Water, agent: str, reliability: bool) -> None:
    """And one of the MTU is not: what the link adds takes no room of it."""
    mtu = program.get(agent, "MTU")
    for size, kind in ((mtu, "Message"), (mtu + 1, "RefuseRsp")):
        program.requests(f"{UNET}.DatagramReq", agent, to=2, data=[1] * size, reliability=reliability)
        assert program.message()[0] == kind


@pytest.mark.parametrize("reliability", [True, False])
def test_a_long_datagram_of_the_link_is_sent_in_pieces(program: Program, water: Water, reliability: bool) -> None:
    """One after the other, whatever room there is, and told when all of them are on their way or acknowledged."""
    program.say(action="wantsMessagesFor", agentIDs=["#uwlink__ntf"])
    data = list(range(150))
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, protocol=32, data=data, reliability=reliability)
    assert program.message()[1]["perf"] == "AGREE"
    pieces = []
    for number in range(3):
        request = water.sends(at_s=1.0 + number)
        pieces.append(request)
        if reliability:
            assert not water.given
            answer = bytes((0, request.head[1], 32))
            water.brings(2, b"", head=answer, what=Unet.link, left=2.0 + number, came=2.2 + number)
    kind, told = program.message()
    if reliability:
        assert kind == "DatagramDeliveryNtf"
    else:
        assert (kind, told["txTime"], told["duration"]) == ("TxFrameNtf", 1_000_000, 300.0)
    assert [len(piece.payload) for piece in pieces] == [64, 64, 22]
    for piece in pieces:
        water.brings(3, piece.payload, head=piece.head, what=piece.what, left=5.0, came=5.2)
    kind, told = program.message()
    assert kind == "DatagramNtf" and base64.b64decode(told["data"]["data"]) == bytes(data)


@pytest.mark.parametrize("reliability", [True, False])
def test_the_pieces_of_a_datagram_end_with_the_first_that_is_lost_or_cleared(
    program: Program, water: Water, reliability: bool
) -> None:
    kind = f"{UNET}.DatagramReq"
    program.requests(kind, "uwlink", to=2, data=[1] * 150, reliability=reliability)
    assert program.message()[1]["perf"] == "AGREE"
    for _ in range(3 if reliability else 1):
        water.core.on_dropped(water.next().tag, Cause.MUTE)
    assert program.message()[0] == "DatagramFailureNtf" and not water.given
    program.requests(kind, "uwlink", to=2, data=[1] * 150, reliability=reliability)
    assert program.message()[1]["perf"] == "AGREE"
    request = water.next()
    program.requests(f"{UNET}.ClearReq", "phy")
    told = [program.message()[0]]
    if not reliability:  # its first piece is in the channel, and goes on
        water.core.on_sent(SentFrame(request.tag, water.at(1.0), 100_000_000))
    told.append(program.message()[0])
    assert sorted(told) == ["DatagramFailureNtf", "Message"] and not water.given


def test_a_name_that_nobody_has_is_no_address(program: Program) -> None:
    """Of any answer `host` of unetpy reads the address."""
    program.requests(f"{UNET}.addr.AddressResolutionReq", "arp", name="nobody")
    kind, data = program.message()
    assert (kind, data["perf"], data["address"]) == ("AddressResolutionRsp", "FAILURE", None)


def test_a_frame_of_the_link_that_comes_twice_is_told_once(program: Program, water: Water) -> None:
    program.say(action="wantsMessagesFor", agentIDs=[DATAGRAM_TOPIC])
    program.asks("services")
    for _ in range(2):
        water.brings(2, b"x", head=bytes((1, 5, 32)), what=Unet.link, left=1.0, came=1.2)
        assert water.sends().head == bytes((0, 5, 32))  # its acknowledgement
    assert program.message()[0] == "DatagramNtf"
    assert program.asks("containsAgent", agentID="phy")["answer"] is True  # and no second one came before
    for number in (6, 5):  # the acknowledgement of the older one was lost
        water.brings(2, b"x", head=bytes((1, number, 32)), what=Unet.link, left=2.0, came=2.2)
    assert program.message()[0] == "DatagramNtf"
    assert program.asks("containsAgent", agentID="phy")["answer"] is True


def test_a_frame_that_is_never_acknowledged_is_sent_three_times(program: Program, water: Water) -> None:
    """What is lost before it left counts as a try."""
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
    assert program.message()[1]["perf"] == "AGREE"
    for _ in range(3):
        water.core.on_dropped(water.next().tag, Cause.MUTE)
    kind, data = program.message()
    assert (kind, data["to"]) == ("DatagramFailureNtf", 2) and not water.given


def test_what_is_lost_twice_before_it_left_is_one_try(program: Program, water: Water) -> None:
    """The channel may tell a loss more than once, and a modem with tries transmits once per neighbour."""
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
    assert program.message()[1]["perf"] == "AGREE"
    tags = []
    for _ in range(2):
        tags.append(water.next().tag)
        water.core.on_dropped(tags[-1], Cause.MUTE)
        water.core.on_dropped(tags[-1], Cause.MUTE)
        water.core.on_sent(SentFrame(tags[0], water.at(1.0), 100_000_000))
    number = water.sends().head[1]
    water.brings(2, b"", head=bytes((0, number, 0)), what=Unet.link, left=2.0, came=2.2)
    assert program.message()[0] == "DatagramDeliveryNtf" and len(set(tags)) == 2


def test_what_is_cleared_is_told(program: Program, water: Water) -> None:
    """Two wait for their acknowledgements, and a frame waits behind them. Else a program would wait for ever."""
    for reliability in (True, True, False):
        program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=reliability)
        assert program.message()[1]["perf"] == "AGREE"
    program.requests(f"{UNET}.ClearReq", "phy")
    told = [program.message() for _ in range(4)]
    assert [kind for kind, _ in told] == ["DatagramFailureNtf"] * 3 + ["Message"]
    assert told[2][1]["reason"] == "cleared"
    for _ in range(300):  # numbers of frames are free again
        program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
        assert program.message()[1]["perf"] == "AGREE"
        program.requests(f"{UNET}.ClearReq", "phy")
        assert [program.message()[0] for _ in range(2)] == ["DatagramFailureNtf", "Message"]


def test_a_full_queue_holds_up_no_second_try_and_no_answer(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
    for _ in range(2):
        program.requests(f"{UNET}.DatagramReq", "phy", data=[8])
    assert [program.message()[1]["perf"] for _ in range(3)] == ["AGREE"] * 3
    water.brings(3, b"\7", what=RANGING, left=1.0, came=2.0)
    water.core.on_dropped(water.next().tag, Cause.MUTE)
    given = [water.sends().what for _ in range(4)]
    assert given == [0, 0, RANGING, Unet.link] and not water.core.remark


def test_a_second_try_that_finds_no_room_at_all_has_failed(
    program: Program, water: Water, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else nobody would ever learn what became of the payload."""
    monkeypatch.setattr("fleet.addons.modems.modem._MOST_OWN", 0)
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
    for _ in range(2):
        program.requests(f"{UNET}.DatagramReq", "phy", data=[8])
    assert [program.message()[1]["perf"] for _ in range(3)] == ["AGREE"] * 3
    water.core.on_dropped(water.next().tag, Cause.MUTE)
    assert program.message()[0] == "DatagramFailureNtf" and water.next().payload == b"\x08"


def test_an_acknowledgement_of_another_node_delivers_nothing(program: Program, water: Water) -> None:
    program.requests(f"{UNET}.DatagramReq", "uwlink", to=2, data=[7], reliability=True)
    assert program.message()[1]["perf"] == "AGREE"
    number = water.sends().head[1]
    for src in (3, 2):
        water.brings(src, b"", head=bytes((0, number, 0)), what=Unet.link, left=2.0, came=2.2)
    assert program.message()[0] == "DatagramDeliveryNtf"
    assert program.asks("containsAgent", agentID="phy")["answer"] is True  # and no second one came before


def test_a_modem_that_hears_something_is_busy_and_says_when_it_begins(program: Program, water: Water) -> None:
    """This is what a program with a MAC of its own senses the carrier by."""
    program.say(action="wantsMessagesFor", agentIDs=["#phy__ntf"])
    assert program.get("phy", "busy") is False
    water.core.on_reached(Sound(water.at(0.25), water.at(1e6)))
    kind, data = program.message()
    assert (kind, data["rxTime"]) == ("RxFrameStartNtf", 250_000)
    assert program.get("phy", "busy") is True and water.core.state == "receiving"
    program.requests(f"{UNET}.DatagramReq", "phy", to=2, data=[1])
    assert program.message()[1]["perf"] == "AGREE"
    now_s = (monotonic_ns() - water.begin_ns) / 1e9
    request = water.next()
    water.core.on_sent(SentFrame(request.tag, water.at(now_s), 10**15))
    assert program.message()[0] == "TxFrameNtf" and water.core.state == "transmitting"
    water.core.on_reached(Sound(water.at(now_s), water.at(1e6)))  # which it does not hear
    assert program.asks("containsAgent", agentID="phy")["answer"] is True


def test_what_is_not_understood_is_told(program: Program) -> None:
    program.requests(f"{UNET}.bb.TxBasebandSignalReq", "phy")
    assert program.message()[1]["perf"] == "NOT_UNDERSTOOD"


def test_all_parameters_have_their_names(program: Program) -> None:
    """A client of fjage takes the first one as the answer, and the others beside it."""
    program.requests("org.arl.fjage.param.ParameterReq", "phy")
    data = program.message()[1]
    assert {data["param"], *data["values"]} == {
        "MTU", "RTU", "busy", "time", "rxEnable", "propagationSpeed", "timestampedTxDelay",
    }  # fmt: skip
    assert data["param"] == "MTU" and data["value"] == 64


@pytest.mark.parametrize(
    "odd",
    [{"kind": f"{UNET}.DatagramReq", "recipient": "phy", "data": [float("inf")]},
     {"kind": "org.arl.fjage.param.ParameterReq", "recipient": "node", "param": "location", "value": [10**400, 0, 0]},
     {"kind": "org.arl.fjage.param.ParameterReq", "recipient": "node", "requests": 5}],
)  # fmt: skip
def test_an_odd_value_ends_no_connection(program: Program, odd: dict[str, Any]) -> None:
    program.requests(**odd)
    assert program.message() and program.asks("containsAgent", agentID="phy")["answer"] is True


@pytest.mark.parametrize(
    "rubbish",
    [b"\x00\xff{}\n", b"[]\n", b"{\n" * 50, b'{"action": "send", "message": {"data": 5}}\n', b"[" * 100_000 + b"\n",
     b'{"action": "wantsMessagesFor", "agentIDs": {"a": 1}}\n'],
)  # fmt: skip
def test_rubbish_disturbs_nobody(program: Program, water: Water, rubbish: bytes) -> None:
    with closing(Program(water.core.line_port.port)) as other:
        other.socket.sendall(rubbish)
        assert program.asks("containsAgent", agentID="phy")["answer"] is True


def test_who_takes_nothing_loses_its_connection_and_holds_up_nobody(program: Program, water: Water) -> None:
    with closing(Program(water.core.line_port.port)) as other:
        other.say(action="wantsMessagesFor", agentIDs=[DATAGRAM_TOPIC])
        other.asks("services")

        def gone() -> bool:
            for _ in range(1000):
                water.brings(2, bytes(64), left=1.0, came=1.1)
            return len(water.core.line_port.clients) == 1

        wait_for(gone, LIMIT_S, "the end of its connection")
    assert program.asks("containsAgent", agentID="phy")["answer"] is True
