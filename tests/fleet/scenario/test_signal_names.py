"""How signals are spelled: one grammar for checks, measures, charts, pictures and differences."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.scenario.sections.signals import SignalName, component, parse_name

WORDS = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
NAMES = st.builds("{}.{}".format, WORDS, WORDS)


@given(st.builds(SignalName, NAMES, st.booleans(), st.none() | st.integers(1, 999_999)))
def test_every_name_reads_back(name: SignalName) -> None:
    assert parse_name(str(name)) == name


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("state.z", SignalName("state.z")),
        ("uuv/*/state.z", SignalName("state.z")),
        (" | uuv/3/error.e | ", SignalName("error.e", absolute=True, vehicle=3)),
        ("uuv/1/" + component("command.tau", 0), SignalName("command.tau_0", vehicle=1)),
    ],
)
def test_a_name(text: str, name: SignalName) -> None:
    assert parse_name(text) == name


@pytest.mark.parametrize(
    "text", ["", "state", "|state.z", "uuv/0/state.z", "command.tau[0]", "link/1-2.delay", "a.b" * 99]
)
def test_what_names_no_signal_of_a_vehicle(text: str) -> None:
    assert parse_name(text) is None
