"""Message indexes: what is found in large steps is what one finds record by record."""

from __future__ import annotations

from struct import pack, unpack_from

from hypothesis import given
from hypothesis import strategies as st

from fleet.logs.salvage import read_indexes

RUNS = st.lists(st.tuples(st.integers(0, 3), st.integers(1, 60)), max_size=8)  # entries of an index, how many such


def indexes(runs: list[tuple[int, int]]) -> bytes:
    """Runs of equal indexes, with channels and places that all differ."""
    data, channel = b"", 0
    for entries, times in runs:
        for _ in range(times):
            channel += 1
            data += pack("<BQHI", 0x07, 6 + 16 * entries, channel, 16 * entries)
            data += b"".join(pack("<QQ", 5, 1000 * channel + k) for k in range(entries))
    return data


def one_by_one(data: bytes) -> tuple[int, list[int]]:
    at, places = 0, []
    while len(data) - at >= 15:
        opcode, length, _, entries = unpack_from("<BQHI", data, at)
        end = at + 15 + entries
        if opcode != 0x07 or length != entries + 6 or entries % 16 or end > len(data):
            break
        places += [unpack_from("<Q", data, k + 8)[0] for k in range(at + 15, end, 16)]
        at = end
    return at, places


@given(RUNS, st.data())
def test_they_are_those_that_are_found_one_by_one(runs: list[tuple[int, int]], data: st.DataObject) -> None:
    """Also if the file is cut, a byte is wrong, or other records follow."""
    text = bytearray(indexes(runs) + data.draw(st.sampled_from([b"", b"\x06" + bytes(40), bytes(3)])))
    if text and data.draw(st.booleans()):
        text[data.draw(st.integers(0, len(text) - 1))] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(0, len(text)))
    text = text[: len(text) - cut // 4]
    end, places = read_indexes(lambda at, length: bytes(text[at : at + length]), 0, 10**6)
    expected_end, expected = one_by_one(bytes(text))
    assert end == expected_end
    assert ([] if places is None else places.tolist()) == expected


def test_windows_that_cut_an_index_lose_nothing() -> None:
    """A thousand vehicles: more indexes of one message than one look at the file holds."""
    text = indexes([(1, 20_000), (2, 20), (1, 500)])
    end, places = read_indexes(lambda at, length: text[at : at + length], 0, 10**6)
    assert (end, places.tolist()) == one_by_one(text)  # type: ignore[union-attr]
