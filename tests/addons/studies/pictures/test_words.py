"""Keys and values in words."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.addons.studies.pictures.points import key_words, value_words


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("network.links.*.loss", "loss of every link"),
        ("network.links.1->2.delay", "delay of link 1->2"),
        ("vehicles", "number of vehicles"),
        ("network.period", "time between rounds"),
        ("formation.spacing", "formation spacing"),
        ("control.k_min", "control k min"),
    ],
)
def test_a_key(key: str, words: str) -> None:
    assert key_words(key) == words


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("{modem: mfsk-1066, mac: tdma, slot: 800 ms}", "mfsk-1066, tdma, slot 800 ms"),
        ("{modem: s2c, mac: aloha} - {modem: fsk-80, mac: aloha}", "s2c, aloha - fsk-80, aloha"),
        ("{wind: 20, shipping: 0.5, ice: false, noise: true}", "wind 20, shipping 0.5, no ice, noise"),
        ("nboc", "nboc"),
        (0.5, "0.5"),
        ("{}", "{}"),
        ("{a: [}", "{a: [}"),
    ],
)
def test_a_value(value: object, words: str) -> None:
    assert value_words(value) == words


def test_words_that_stand_for_many_stay_as_they_are() -> None:
    levels = ", ".join(f"k{n}: &k{n} [{', '.join([f'*k{n - 1}' if n else 'x'] * 9)}]" for n in range(12))
    assert value_words(f"{{{levels}}}") == f"{{{levels}}}"


@given(st.text(max_size=60))
def test_any_text_has_words(text: str) -> None:
    assert isinstance(value_words(text), str) and isinstance(key_words(text), str)
    assert isinstance(value_words("{" + text + "}"), str)
