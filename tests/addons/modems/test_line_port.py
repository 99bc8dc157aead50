"""Clients that speak no language of a modem, or go in the middle: the others notice nothing, in any language."""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from modem_water import LIMIT_S, ModemClient, Water
from waiting import wait_for

from fleet.addons.modems import line_port
from fleet.addons.modems.evologics import EvoLogics
from fleet.addons.modems.line_port import MOST_LINE
from fleet.addons.modems.micromodem import MicroModem
from fleet.addons.modems.modem import ModemLanguage
from fleet.addons.modems.unet import Unet

# A request of each language, and the beginning of its answer; and a payload that it sends.
ASKS = {
    Unet: (b'{"action": "services", "id": "1"}\n', b'{"id": "1"'),
    MicroModem: (b"$CCCFQ,SRC\r\n", b"$CACFG,SRC,1"),
    EvoLogics: (b"+++AT?AL\n", b"+++AT?AL:1:1"),
}
SENDS = {
    Unet: b'{"action": "send", "message": {"clazz": "DatagramReq", "data": {"recipient": "phy", "to": 2}}}\n',
    MicroModem: b"$CCMUC,1,2,0ABC\r\n",
    EvoLogics: b"+++AT*SENDIM,1,2,noack,x\n",
}


@pytest.fixture(params=list(ASKS))
def language(request: pytest.FixtureRequest) -> Callable[[], ModemLanguage]:
    found: Callable[[], ModemLanguage] = request.param
    return found


@pytest.fixture
def water(language: Callable[[], ModemLanguage]) -> Iterator[Water]:
    with closing(Water(language)) as found:
        yield found


def answers(water: Water, language: Callable[[], ModemLanguage]) -> bool:
    """Whether a new client gets the answer to its request. Others may be told more before it."""
    question, answer = ASKS[language]  # type: ignore[index]
    with closing(ModemClient(water.port)) as client:
        client.socket.sendall(question)
        return any(line.startswith(answer) for line in client.file)


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.one_of(st.binary(max_size=300), st.text('{}[]",:$*+AT?CM\n\r0123456789-', max_size=60).map(str.encode)))
def test_rubbish_disturbs_nobody(water: Water, language: Callable[[], ModemLanguage], data: bytes) -> None:
    with closing(ModemClient(water.port)) as client:
        client.socket.sendall(data + b"\n")
        assert answers(water, language)


def test_half_a_line_is_forgotten_with_its_client(water: Water, language: Callable[[], ModemLanguage]) -> None:
    with closing(ModemClient(water.port)) as client:
        client.socket.sendall(SENDS[language][:-3])  # type: ignore[index]
    wait_for(lambda: not water.core.line_port.clients, LIMIT_S, "the end of the connection")
    assert answers(water, language) and not water.given


def test_a_line_without_an_end_ends_its_connection(water: Water, language: Callable[[], ModemLanguage]) -> None:
    with closing(ModemClient(water.port)) as client:
        with pytest.raises((BrokenPipeError, ConnectionResetError)):  # noqa: PT012  # at some later write
            while True:
                client.socket.sendall(b"7" * MOST_LINE)
        assert answers(water, language)


def test_who_goes_in_mid_transmission_has_sent_it(water: Water, language: Callable[[], ModemLanguage]) -> None:
    with closing(ModemClient(water.port)) as client:
        client.socket.sendall(SENDS[language])  # type: ignore[index]
        request = water.next()
    wait_for(lambda: not water.core.line_port.clients, LIMIT_S, "the end of the connection")
    water.given.insert(0, request)
    water.sends()
    assert answers(water, language)
    with closing(ModemClient(water.port)) as client:  # the modem is free again
        client.socket.sendall(SENDS[language])  # type: ignore[index]
        assert water.next().payload == request.payload


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    what=st.integers(0, 80),
    payload=st.one_of(st.binary(max_size=64), st.lists(st.integers(0, 9), max_size=12).map(bytes)),
    head=st.lists(st.integers(0, 9), max_size=8).map(bytes),
)
def test_a_frame_of_any_content_disturbs_no_modem(
    water: Water, language: Callable[[], ModemLanguage], what: int, payload: bytes, head: bytes
) -> None:
    water.brings(2, payload, head=head, what=what, left=1.0, came=1.1, away=(1.0, 0.0, 0.0))
    assert answers(water, language) and not water.core.remark


def test_a_defect_of_ours_costs_one_event_and_is_told(
    water: Water, language: Callable[[], ModemLanguage], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("a defect")

    monkeypatch.setattr(water.core.language, "on_heard", broken)
    water.brings(2, b"1", left=1.0, came=1.1)
    water.core.line_port.post(lambda: water.core.call_after(0.0, broken))
    assert (
        answers(water, language) and water.core.remark == "its modem failed in part: the traceback is in log/relay.log"
    )


def test_without_descriptors_the_thread_rests_and_serves_the_client_later(
    water: Water, language: Callable[[], ModemLanguage], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that waits in the system's queue made the thread try to accept it without an end."""
    tries: list[int] = []
    real = line_port.socket.socket.accept

    def accept(listening: socket.socket) -> Any:
        tries.append(1)
        if len(tries) == 1:
            raise OSError(errno.EMFILE, "Too many open files")
        return real(listening)

    monkeypatch.setattr(line_port.socket.socket, "accept", accept)
    assert answers(water, language)
    assert len(tries) == 2
