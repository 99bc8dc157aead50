"""Numbers in messages of programs: each format at a path, and what is said of messages that hold none."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from math import inf, isnan, nan
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.programs.message_signal import NoNumber, number_at
from fleet.addons.robots.message_values import reader
from fleet.scenario.schema.programs import StackSignalSection

_PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)


def read(payload: bytes, key: str = "a/b", **how: Any) -> float:
    """The number of a message, of a signal that is written so in a file."""
    return reader(StackSignalSection.model_validate({"message": "a/*"} | how))(key, payload)


def problem(payload: bytes, key: str = "a/b", **how: Any) -> str:
    with pytest.raises(NoNumber) as caught:
        read(payload, key, **how)
    return str(caught.value)


@pytest.mark.parametrize(
    ("value", "path", "expected"),
    [
        (5, "", 5.0),
        ([[1, 2, 3.5]], "[0][2]", 3.5),
        ({"pose": {"x": [1, 2]}}, "pose.x[-1]", 2.0),
        ({"ok": True}, "ok", 1.0),
        ({"t": "12.5"}, "t", 12.5),
        ([None, -1e300], "[1]", -1e300),
    ],
)
def test_each_format_has_the_same_number_at_a_path(value: Any, path: str, expected: float) -> None:
    cbor2 = pytest.importorskip("cbor2")
    packed = {"json": json.dumps(value).encode(), "msgpack": msgpack.packb(value), "cbor": cbor2.dumps(value)}
    assert {kind: read(data, **{kind: path}) for kind, data in packed.items()} == dict.fromkeys(packed, expected)


def test_bytes_have_the_number_of_a_layout() -> None:
    """What follows it is left alone."""
    payload = struct.pack("<Hf4s", 7, 2.5, b"rest")
    assert (read(payload, struct="<Hf"), read(payload, struct="<Hf[1]")) == (7.0, 2.5)
    assert problem(payload[:5], struct="<Hf[1]") == "has 5 bytes, and <Hf[1] needs 6"
    assert problem(payload, struct="<H4s[1]").startswith("expected a number, got b'")


def test_a_number_that_is_not_finite_is_read_as_it_is() -> None:
    """The run holds it for nothing said."""
    assert read(b"Infinity", json="") == inf
    assert isnan(read(struct.pack("<d", nan), struct="<d"))
    assert problem(json.dumps(10**400).encode(), json="").startswith("expected a number, got 1000")


@pytest.mark.parametrize(
    ("value", "path", "expected"),
    [
        ({}, "x", "there is no x"),
        ([1], "[1]", "there is no 1"),
        ({"x": 1}, "[0]", "there is no 0"),
        (5, "real.x", "there is no real"),
        ("text", "upper", "there is no upper"),
        ({"x": [1]}, "x", "expected a number, got [1]"),
        ({"x": None}, "x", "expected a number, got None"),
    ],
)
def test_a_path_that_leads_nowhere_is_said(value: Any, path: str, expected: str) -> None:
    """It leads through values of the message alone, and not through what Python makes of them."""
    assert problem(json.dumps(value).encode(), json=path) == expected


@pytest.mark.parametrize("kind", ["json", "msgpack", "cbor"])
@pytest.mark.parametrize("payload", [b"", b"\xff\xfe", b"[" * 100_000, b"\xc1", b"{", b"\x91" * 100_000])
def test_a_damaged_message_is_said_in_one_short_line(kind: str, payload: bytes) -> None:
    """However deep it is."""
    pytest.importorskip("cbor2")
    said = problem(payload, **{kind: "[0].x"})
    assert "\n" not in said and len(said) < 200


@given(st.binary(max_size=40), st.sampled_from(["json", "msgpack", "cbor", "struct"]))
def test_any_bytes_have_a_number_or_none(payload: bytes, kind: str) -> None:
    with suppress(NoNumber):
        assert isinstance(read(payload, **{kind: "<Hb" if kind == "struct" else "[0]"}), float)


@given(_PLAIN, st.lists(st.integers(-3, 3) | st.sampled_from(["x", "real", "__class__"]), max_size=3))
def test_any_value_has_a_number_at_a_path_or_none(value: Any, path: list[str | int]) -> None:
    with suppress(NoNumber):
        assert isinstance(number_at(value, path), float)


@pytest.mark.parametrize(
    ("payload", "kind"),
    [
        (b"\x91" * 1010 + b"\x01", "msgpack"),  # 1,010 lists in each other
        (b"\xc2\x59\x07\xd0" + b"\xff" * 2000, "cbor"),  # a number of 4,817 digits
    ],
)
def test_what_python_cannot_show_is_told_in_words(payload: bytes, kind: str) -> None:
    """One such message ended a run with a traceback."""
    if kind == "cbor":
        pytest.importorskip("cbor2")
    assert problem(payload, **{kind: ""}).startswith("expected a number, got ")


def test_cbor_without_its_library_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cbor2", None)
    assert problem(b"\x05", cbor="") == "is CBOR, which needs uuv-fleet[cbor]"


def test_a_message_of_ros_has_its_fields() -> None:
    """Its key names the type; a key of something else is no topic."""
    pytest.importorskip("rosbags")
    key = "0/depth/std_msgs::msg::dds_::Float64_/RIHS01_" + 64 * "0"
    payload = b"\x00\x01\x00\x00" + struct.pack("<d", -4.5)
    assert read(payload, key, ros="data") == -4.5
    assert problem(payload, key, ros="dada") == "there is no dada"
    assert problem(payload, "a/b", ros="data") == "a/b is no topic of ROS 2"
    for cut in (b"", payload[:6]):
        assert problem(cut, key, ros="data")
    assert problem(payload, key.replace("Float64", "Nothing9"), ros="data")
