"""The bundle algorithm: no conflict within the published bound without loss, and at last with it."""

from __future__ import annotations

from math import dist
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.protocols.bidder import NOBODY, Bidder, News, rounds_needed

Links = list[tuple[int, int]]


def both(*pairs: tuple[int, int]) -> Links:
    return [link for a, b in pairs for link in ((a, b), (b, a))]


def line(n: int) -> Links:
    return both(*((i, i + 1) for i in range(1, n)))


class Auction:
    """Bidders at places, who exchange all they believe in rounds."""

    def __init__(self, places: list[tuple[float, float]], vehicles: list[tuple[float, float]], size: int) -> None:
        self.places, self.vehicles = places, vehicles
        self.bidders = {i: Bidder(i, len(places), size) for i in range(1, len(vehicles) + 1)}
        self.tick = 0

    def score(self, i: int, path: list[int]) -> float:
        t, at, total = 0.0, self.vehicles[i - 1], 0.0
        for j in path:
            t += dist(at, self.places[j])
            at = self.places[j]
            total += 0.98**t
        return total

    def round(self, links: Links, loss: float = 0.0, draw: Random | None = None) -> None:
        self.tick += 10
        for i, bidder in self.bidders.items():
            bidder.choose(lambda path, i=i: self.score(i, list(path)))  # type: ignore[misc]
        said = {i: News(list(b.bids), list(b.winners), {**b.heard, i: self.tick}) for i, b in self.bidders.items()}
        for src, dst in links:
            if src in said and dst in self.bidders and (draw is None or draw.random() >= loss):
                self.bidders[dst].hear(src, said[src])

    def settle(self) -> None:
        """What was heard last is answered."""
        for i, bidder in self.bidders.items():
            bidder.choose(lambda path, i=i: self.score(i, list(path)))  # type: ignore[misc]

    def claims(self) -> list[int]:
        return [j for bidder in self.bidders.values() for j in bidder.bundle]


PLACES = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=1, max_size=9)


@given(places=PLACES, vehicles=st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=2, max_size=5),
       size=st.integers(1, 4))  # fmt: skip
def test_no_conflict_within_the_published_bound(
    places: list[tuple[float, float]], vehicles: list[tuple[float, float]], size: int
) -> None:
    """In a line, whose diameter is the longest; many places and vehicles are equal, so that bids tie."""
    auction = Auction(places, vehicles, size)
    n = len(vehicles)
    for _ in range(rounds_needed(len(places), n, size, diameter=n - 1)):
        auction.round(line(n))
    auction.settle()
    claims = auction.claims()
    assert len(claims) == len(set(claims)) == min(len(places), n * size)
    for bidder in auction.bidders.values():
        assert bidder.winners == auction.bidders[1].winners
        mine = [j for j, winner in enumerate(bidder.winners) if winner == bidder.number]
        assert sorted(bidder.path) == sorted(bidder.bundle) == mine
    before = [list(bidder.path) for bidder in auction.bidders.values()]
    auction.round(line(n))
    assert [bidder.path for bidder in auction.bidders.values()] == before  # nothing changes any more


@given(seed=st.integers(0, 10**6), loss=st.sampled_from([0.3, 0.7]))
def test_with_loss_it_takes_longer_and_comes_to_the_same(seed: int, loss: float) -> None:
    draw = Random(seed)
    places = [(draw.uniform(0, 60), draw.uniform(0, 60)) for _ in range(7)]
    vehicles = [(draw.uniform(0, 60), draw.uniform(0, 60)) for _ in range(4)]
    whole, lossy = Auction(places, vehicles, 2), Auction(places, vehicles, 2)
    for _ in range(rounds_needed(7, 4, 2, 3)):
        whole.round(line(4))
    for _ in range(400):
        lossy.round(line(4), loss, draw)
    assert [bidder.winners for bidder in lossy.bidders.values()] == [
        bidder.winners for bidder in whole.bidders.values()
    ]
    assert NOBODY not in lossy.bidders[1].winners


def test_two_halves_share_out_all_places_each_and_settle_when_they_meet() -> None:
    """Apart, both halves claim what they would leave to the other; together the higher bid keeps it."""
    draw = Random(3)
    places = [(draw.uniform(0, 60), draw.uniform(0, 60)) for _ in range(4)]
    auction = Auction(places, [(0.0, 0.0), (0.0, 50.0), (60.0, 0.0), (60.0, 50.0)], 2)
    for _ in range(10):
        auction.round(both((1, 2), (3, 4)))
    assert sorted(auction.claims()) == [0, 0, 1, 1, 2, 2, 3, 3]
    for _ in range(rounds_needed(4, 4, 2, 3)):
        auction.round(line(4))
    assert sorted(auction.claims()) == [0, 1, 2, 3]


def test_the_tasks_of_who_is_gone_are_shared_out_again() -> None:
    auction = Auction([(5.0, 0.0), (6.0, 0.0), (50.0, 0.0)], [(0.0, 0.0), (40.0, 0.0), (90.0, 0.0)], 3)
    for _ in range(6):
        auction.round(line(3))
    lost = list(auction.bidders[1].bundle)
    assert lost == [0, 1]
    del auction.bidders[1]
    for bidder in auction.bidders.values():
        assert bidder.forget(1)
        assert not bidder.forget(1)
    for _ in range(6):
        auction.round(line(3))
    assert sorted(auction.claims()) == [0, 1, 2]


def test_who_is_outbid_gives_up_all_that_it_chose_later() -> None:
    bidder = Bidder(1, 3, 3)
    bidder.choose(lambda path: sum(0.5**n * (3 - j) for n, j in enumerate(path)) / 10)
    assert bidder.bundle == [0, 1, 2]
    second = bidder.bids[1]
    bidder.hear(2, News([0.0, second + 0.1, 0.0], [NOBODY, 2, NOBODY], {2: 10}))
    assert (bidder.bundle, bidder.path, bidder.winners) == ([0], [0], [1, 2, NOBODY])


def test_old_news_change_nothing() -> None:
    bidder = Bidder(1, 1, 1)
    bidder.hear(2, News([0.5], [2], {2: 20}))
    bidder.hear(2, News([0.9], [2], {2: 10}))
    assert (bidder.bids, bidder.heard) == ([0.5], {2: 20})


def test_what_is_done_is_not_chosen() -> None:
    bidder = Bidder(1, 2, 2)
    bidder.choose(lambda path: 0.1 * len(path), frozenset({0}))
    assert bidder.path == [1]
    assert bidder.finish(1)
    assert not bidder.finish(1)
    assert bidder.bundle == bidder.path == []


@pytest.mark.parametrize(("size", "rounds"), [(1, 12), (2, 21), (9, 21)])
def test_the_bound_counts_the_tasks_that_can_be_taken(size: int, rounds: int) -> None:
    assert rounds_needed(tasks=7, vehicles=4, size=size, diameter=3) == rounds
