"""Scenarios with nodes: names in place of numbers, what they may hold, and what they say of a mistake."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import fleet
from fleet.analysis.preflight import warnings
from fleet.errors import FleetError, ScenarioError
from fleet.execution.external_agents import refuse
from fleet.execution.fault_request import RefusedError, check_fault
from fleet.scenario.loading import parse_scenario
from fleet.scenario.scenario import Scenario
from fleet.scenario.sections.node_names import to_names, to_numbers
from fleet.scenario.text.overrides import Override
from netem.link_states import LinkStates

NODES: dict[str, Any] = {name: {"listen": f"tcp/127.0.0.1:{port}"} for name, port in (("a", 1), ("b", 2), ("shore", 3))}


def scenario(**sections: Any) -> Scenario:
    return parse_scenario(yaml.safe_dump({"title": "A stack", "nodes": NODES, **sections}), "stack.yaml")


def mistakes(**sections: Any) -> str:
    with pytest.raises(ScenarioError) as caught:
        scenario(**sections)
    return "\n".join(f"{problem.key}: {problem.message}; {problem.hint}" for problem in caught.value.problems)


def modems(*each: dict[str, Any], water: bool = True) -> dict[str, Any]:
    """Sections of a file whose nodes have these modems."""
    nodes: dict[str, Any] = {"z": {"place": "9 0 10 m"}}
    nodes |= {name: {"modem": modem, "place": "0 0 10 m"} for name, modem in zip("abc", each, strict=False)}
    return {"nodes": nodes} | ({"network": {"acoustic": {"queue": 4}}} if water else {})


def test_names_stand_where_numbers_do() -> None:
    found = scenario(
        graph={"edges": ["a-b", "b->shore"], "reference": ["shore"]},
        network={"links": {"a<->b": "loss 10%", "b->*": "delay 1s"}, "radios": {"a, shore": "rate 80kbit"}},
        faults=[
            {"at": "1 s", "for": "1 s", "partition": "a / b,shore"},
            {"at": "5 s", "mute": "shore"},
            {"at": "6 s", "link": {"a->b": "loss 50%"}},
            {"at": "7 s", "id": "a", "partition": "isolate:a"},
        ],
        checks={"max_age": {"below": "5 s", "links": "a->b"}},
    )
    assert set(found.graph.links) == {(1, 2), (2, 1), (2, 3)}
    assert found.graph.b == (0.0, 0.0, 1.0)
    assert found.conditions[1, 2].loss == 0.1
    assert found.conditions[2, 3].delay_ns == 10**9
    assert {i: radio.rate_bit_s for i, radio in found.netem_config.radios.items()} == {1: 80_000, 3: 80_000}
    cut, mute, link, alone = found.faults.network
    assert set(cut.links) == {(1, 2), (2, 1)}
    assert (mute.vehicles, link.links, alone.id) == ((3,), ((1, 2),), "a")
    assert [event.what for event in found.faults.events if event.action == "begins"] == [
        "partition a / b,shore", "mute shore", "link a->b: loss 50%", "partition isolate:a",
    ]  # fmt: skip
    assert found.link_name((2, 3)) == "b->shore"


def test_names_may_have_dashes() -> None:
    names = ("auv", "auv-1", "auv-10", "b", "ship-a-2")
    nodes = {name: {"listen": f"tcp/127.0.0.1:{port}"} for port, name in enumerate(names, start=1)}
    nodes["b"] = {"udp": {"9000": "auv-1:9100"}}
    found = scenario(
        nodes=nodes,
        graph={"edges": ["auv-1-auv-10", "auv->ship-a-2", "ship-a-2<->b", "b->auv-1"]},
        network={"links": {"auv-1<->auv-10": "loss 10%", "auv->*": "delay 1s"}},
        faults=[{"at": "1 s", "for": "1 s", "partition": "auv-1,auv / auv-10"}],
    )
    assert set(found.graph.links) == {(2, 3), (3, 2), (1, 5), (5, 4), (4, 5), (4, 2)}
    assert (found.conditions[3, 2].loss, found.conditions[1, 5].delay_ns) == (0.1, 10**9)
    assert {(2, 3), (3, 2)} <= set(found.faults.network[0].links)
    assert parse_scenario(found.to_yaml(), "again.yaml") == found


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ('nodes."a.1".place=1 2 3 m', (1.0, 2.0, 3.0)),
        ('nodes."b".place=4 5 6 m', (4.0, 5.0, 6.0)),
        ("nodes.b.place=4 5 6 m", (4.0, 5.0, 6.0)),
        ('network.links."a.1<->b".loss=30 %', 0.3),
        ('network.links."b->a.1".states.bad.loss=30 %', 0.3),
        ('network.links."b->a.1".states.bad.mean=7 s', 7 * 10**9),
        ('network.radios."a.1"=rate 10kbit', 10_000),
        (Override("--net", "a.1->b loss 50%"), 0.5),
        (Override("--fault", "at 9s for 1s down a.1<->b"), "down a.1<->b"),
    ],
)
def test_names_may_have_dots_which_need_quotes_in_a_path(override: str | Override, expected: object) -> None:
    nodes = {name: {"listen": f"tcp/127.0.0.1:{port}"} for port, name in enumerate(("a", "a.1", "b"), start=1)}
    states = {"bad": {"condition": "loss 80%", "mean": "1.5 s"}, "good": {"mean": "9 s"}}
    links = {"a.1<->b": "delay 1.5s", "b->a.1": {"states": states}}
    network = {"links": links, "radios": {"a.1": "rate 80kbit"}}
    graph = {"edges": ["a.1-b", "a->a.1"]}
    text = yaml.safe_dump({"title": "A stack", "nodes": nodes, "graph": graph, "network": network})
    found = parse_scenario(text, "stack.yaml", [override])
    assert parse_scenario(found.to_yaml(), "again.yaml") == found
    assert set(found.graph.links) == {(1, 2), (2, 3), (3, 2)}
    bad = found.changing.get((3, 2))
    assert isinstance(bad, LinkStates)
    assert expected in (
        (found.spec.nodes or {})["a.1"].place,
        (found.spec.nodes or {})["b"].place,
        found.conditions[2, 3].loss,
        bad.conditions[0].loss,
        bad.mean_ns[0],
        found.netem_config.radios[2].rate_bit_s,
        *(event.what for event in found.faults.events),
    )


@pytest.mark.parametrize("path", ["", ".", "nodes.", ".nodes", "nodes..a", 'nodes."a', 'nodes."".place', 'nodes."a"b'])
def test_what_is_no_path_is_told(path: str) -> None:
    with pytest.raises(ScenarioError, match="not an override"):
        parse_scenario(yaml.safe_dump({"title": "A stack", "nodes": NODES}), "stack.yaml", [f"{path}=1"])


_names = st.from_regex(r"[a-c]([.-]?[a-c1-2]){0,3}", fullmatch=True)


@given(st.lists(_names, min_size=2, max_size=6, unique=True), st.data())
def test_a_selector_of_names_with_dashes_and_dots_means_what_numbers_do(names: list[str], data: st.DataObject) -> None:
    numbers = data.draw(st.lists(st.integers(1, len(names)), min_size=2, max_size=4))
    joints = data.draw(st.lists(st.sampled_from(["->", "<->", ",", " / ", ", "]), min_size=3, max_size=3))
    text = "".join(f"{{{n}}}{joint}" for n, joint in zip(numbers, [*joints, ""], strict=False)).rstrip("->,/< ")
    with_names = re.sub(r"{(\d)}", lambda found: names[int(found[1]) - 1], text)
    with_numbers = re.sub(r"[{}]", "", text)
    assert to_numbers(with_names, names) == with_numbers
    assert to_names(with_numbers, names) == with_names


@pytest.mark.parametrize(
    ("wrong", "key"),
    [({"listem": "tcp/127.0.0.1:1"}, "nodes.a.listem"), (5, "nodes.a"), ({"listen": 7561}, "nodes.a.listen")],
)
@pytest.mark.parametrize("others", [["b"], ["b", "shore"]])
def test_a_mistake_in_a_node_is_told_however_many_are_left(wrong: object, key: str, others: list[str]) -> None:
    """Without the wrong one of two nodes the section would be too short, which nobody has to be told."""
    assert mistakes(nodes={"a": wrong, **{name: NODES[name] for name in others}}).startswith(f"{key}: ")


def test_the_record_of_a_run_loads_to_an_equal_scenario() -> None:
    found = scenario(
        carry=["*/x/**"], header="20 bytes", discovery="linked", lost_after="3 s", log={"payloads": "yes"},
        graph={"edges": ["a-b"]}, network={"links": {"a->b": "loss 10%"}, "radios": {"a, b": "rate 80kbit"}},
        faults=[{"at": "1 s", "down": "a->b"}], checks={"max_age": {"below": "5 s", "links": "a->b"}},
    )  # fmt: skip
    text = found.to_yaml()
    assert "a->b: loss 10%" in text and '"a,b": rate 80kbit' in text
    assert "reference:" not in text
    again = parse_scenario(text, "again.yaml")
    assert again == found
    assert again.to_yaml() == text


def test_modems_may_leave_their_ports_open() -> None:
    nodes = scenario(**modems({"unet": 0}, {"micromodem": 0}, {"evologics": 0})).spec.nodes or {}
    assert [node.modem.where for node in nodes.values() if node.modem is not None] == [0, 0, 0]


def test_rules_about_payloads_of_vehicles_concern_no_programs() -> None:
    """A slot holds a byte of theirs, and the modem of 32 bytes tells them its length."""
    nodes = modems({"micromodem": 0}, {"micromodem": 0}, water=False)
    acoustic = scenario(**nodes, network={"acoustic": {"modem": "fsk-80", "queue": 8}}).netem_config.acoustic
    assert acoustic is not None and acoustic.modem.mtu == 32
    slots = {"modem": "s2c", "mac": "tdma", "slot": "600 ms", "guard": "200 ms", "queue": 4}
    assert scenario(**nodes, network={"acoustic": slots}).netem_config.acoustic is not None
    assert "1 byte is 0.172102 s on the air" in mistakes(**nodes, network={"acoustic": slots | {"slot": "300 ms"}})


@pytest.mark.parametrize(("mac", "airtimes"), [("aloha", 0.0), ("csma", 2.0)])
def test_a_modem_with_a_queue_does_not_keep_programs_waiting(mac: str, airtimes: float) -> None:
    """For twenty vehicles that all send states the default is a minute, which programs of others took for a hang."""
    sections = modems({"unet": 0}, {"unet": 0})
    sections["network"]["acoustic"] |= {"modem": "s2c", "mac": mac}
    acoustic = scenario(**sections).acoustic
    assert acoustic is not None
    longest_s = acoustic.modem.airtime_ns(acoustic.modem.mtu) / 1e9
    assert acoustic.backoff_ticks * 0.01 == pytest.approx(airtimes * longest_s, abs=0.02)


def test_without_an_end_it_runs_until_it_is_stopped() -> None:
    assert not scenario().ends
    assert scenario(duration="5 s").ends


@pytest.mark.parametrize(
    ("sections", "expected"),
    [
        ({"graph": {"edges": ["a-c"]}}, "there is no node c"),
        ({"graph": {"edges": ["a b"]}}, "expected an edge between two nodes"),
        ({"faults": [{"at": "1 s", "partition": "a / c"}]}, "there is no node c; the nodes are a, b, shore"),
        ({"faults": [{"at": "1 s", "kill": "a"}]}, "kill concerns vehicles of ours"),
        ({"checks": {"formation_error": {"below": "1 m"}}}, "judges vehicles of ours"),
        ({"carry": ["a//b"]}, "zenoh takes no such key expression"),
        ({"vehicle": {"model": "remus"}}, '"vehicle" has no meaning for nodes'),
        ({"fragments": "yes"}, "has no effect without an acoustic channel"),
        ({"lost_after": "1 s"}, "has no effect without discovery: linked"),
        ({"network": {"acoustic": {"modem": "s2c"}}}, "has no place, and sound needs one"),
        (modems({"unet": 1101}, water=False), "nodes.a.modem: needs water; network: {acoustic: {queue: 10}}"),
        (modems({}), "nodes.a.modem: has one language; modem: {unet: 1101}"),
        (modems({"unet": 1101, "evologics": 9200}), "nodes.a.modem: has one language"),
        (modems({"unet": 1101}, {"evologics": 1101}), "nodes.b.modem: a has 1101, too; give it another"),
        (modems({"micromodem": "/tmp/tty"}, {"micromodem": "/tmp/tty"}), "nodes.b.modem: a has /tmp/tty, too"),
        (modems({"unet": 65536}), "nodes.a.modem.unet: expected a port from 0 to 65535, got 65536; 0 is a free one"),
        (modems({"micromodem": {}}), "nodes.a.modem.micromodem: expected a port from 0 to 65535, or the path of a"),
        (modems({"micromodem": ""}), "nodes.a.modem.micromodem: expected a port from 0 to 65535, or the path of a"),
        (modems({"unet": 0, "address": 2}, {"unet": 0}), "nodes.b.modem: a has the address 2, too"),
        (modems({"micromodem": 0, "address": 127}), "nodes.a.modem: micromodem has addresses up to 126, got 127"),
        (modems({"evologics": 0, "address": 255}), "nodes.a.modem: evologics has addresses up to 254, got 255"),
        (modems({"unet": 0, "mode": "data"}), "nodes.a.modem.mode: has no effect on unet: it belongs to evologics"),
        (modems({"micromodem": 0, "usbl": "1 deg"}), "nodes.a.modem.usbl: has no effect on micromodem"),
        (modems({"evologics": 0, "usbl": "60 deg"}), "nodes.a.modem.usbl: must be between 0 and 45 deg; usbl: 1 deg"),
        (modems({"evologics": 0, "usbl": "yes"}), "nodes.a.modem.usbl: expected an angle"),
        (modems({"evologics": 0, "mode": "at"}), "nodes.a.modem.mode: "),
        (modems({"unet": 0, "address": 256}), "nodes.a.modem.address"),
        (modems({"uneet": 1101}), "nodes.a.modem.uneet"),
        ({"network": {"acoustic": {"modem": "s2c", "queue": 0}}}, "network.acoustic.queue"),
        ({"nemesis": {"mode": "swarm", "pick": ["partition", "kill"]}}, "concerns vehicles of ours"),
        ({"nodes": {**NODES, "b": {"listen": "tcp/127.0.0.1:1"}}}, "a has the address tcp/127.0.0.1:1, too"),
        ({"nodes": {**NODES, "b": {"listen": "127.0.0.1:1"}}}, "expected an address of zenoh"),
        *(
            (
                {"nodes": {**NODES, name: {"listen": "tcp/127.0.0.1:4"}}},
                "expected a name of letters, digits, _, - and .",
            )
            for name in (
                "1b",
                "b-",
                "b--1",
                "-b",
                "b.",
                "b..1",
                "b.-1",
                ".b",
                "b 1",
                "all",
                "link",
                "run",
                "faults",
                "b" * 33,
            )
        ),
        ({"graph": {"edges": ["a-1->b"]}}, "there is no node a-1"),
        ({"nodes": {"a": None}}, "nodes: must have 2 or more entries, got 1"),
        ({"graph": {"edges": ["a.1->b"]}}, "there is no node a.1"),
        ({"graph": {"edges": ["b->a."]}}, "expected an edge between two nodes"),
        ({"nodes": {**NODES, "d": {"udp": {"9000": "e:9100"}}}}, "there is no other node e"),
        ({"nodes": {**NODES, "d": {"udp": {"90000": "a:9100"}}}}, "expected a port from 1 to 65535"),
        ({"nodes": {**NODES, "d": {"udp": {"9000": "a"}}}}, "a sends nothing to d"),
        ({"nodes": {**NODES, "d": {"udp": {"9000": "a:[::1]:9100"}}}}, "datagrams go to addresses of IPv4"),
        ({"nodes": {**NODES, "d": {"udp": {"9000": "a:::1:9100"}}}}, "expected a node and the port of its program"),
        ({"nodes": {**NODES, "d": {"udp": {"9000": "a:1", "9001": "a:2"}}}}, "the link d->a has a port already"),
        (
            {"nodes": {"a": {"udp": {"9000": "b:192.0.2.7:9100"}}, "b": {"udp": {"9001": "a:9101"}}}},
            "nodes.a.udp.9000: datagrams leave from 127.0.0.1, which reaches no other host; nodes.b.host: 0.0.0.0",
        ),
        (
            {"nodes": {"a": {"udp": {"9000": "b:192.0.2.7:9100"}}, "b": {}}},
            "nodes.a.udp.9000: datagrams leave from 127.0.0.1, which reaches no other host; nodes.a.host: 0.0.0.0",
        ),
    ],
)
def test_a_mistake_is_told(sections: dict[str, Any], expected: str) -> None:
    assert expected in mistakes(**sections)


def test_a_topic_that_says_a_place_needs_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = {**NODES, "a": {"listen": "tcp/127.0.0.1:1", "place": {"topic": "a/odom"}}}
    monkeypatch.setattr("fleet.scenario.rules.nodes.find_spec", lambda name: name)
    scenario(nodes=nodes)
    monkeypatch.setattr("fleet.scenario.rules.nodes.find_spec", lambda name: None)
    assert mistakes(nodes=nodes).endswith("a topic needs the extra ros2; pip install 'uuv-fleet[ros2]'")


def test_studies_and_runs_of_vehicles_refuse_it() -> None:
    with pytest.raises(FleetError, match="fleet netem runs it"):
        fleet.run(scenario(duration="1 s"))
    with pytest.raises(FleetError, match="fleet netem runs it"):
        refuse(scenario(), "a run of a study")


def test_what_belongs_to_nodes_means_nothing_without_them() -> None:
    with pytest.raises(ScenarioError, match="has no effect without nodes"):
        parse_scenario("title: x\ncarry: ['**']\nvehicles: 1\n", "x.yaml")


@pytest.mark.parametrize("text", ["a / b,shore", "a->b", "*->shore", "halves", "isolate:b", "delay 300ms", "a.csv"])
def test_a_selector_and_back(text: str) -> None:
    assert to_names(to_numbers(text, list(NODES)), list(NODES)) == text


def test_a_queue_that_a_long_delay_fills_is_doubted() -> None:
    """How often a program sends is unknown, so what passes is told if it is little, or if a limit is given."""
    told = [warnings(scenario(network={"links": {"a->b": text}})) for text in ("delay 15s", "delay 300ms limit 900")]
    assert [re.findall("link a->b: at most .* per second", line)[0] for (line, *_) in told] == [
        "link a->b: at most 66.67 packets per second", "link a->b: at most 3000 packets per second",
    ]  # fmt: skip
    for fits in ("delay 300ms", "delay 300ms rate 80kbit limit 10"):
        assert not re.findall("at most", "".join(warnings(scenario(network={"links": {"a->b": fits}}))))


def test_the_name_of_a_preset_is_no_node() -> None:
    nodes = {"lte": NODES["a"], "b": NODES["b"]}
    assert scenario(nodes=nodes, network={"links": {"lte->b": {"preset": "lte-good"}}}).conditions[2, 1].rate_bit_s


PROGRAMS = {"a": {"run": "true"}, "shore/gcs": {"run": "true"}}


def test_checks_name_programs_by_their_nodes() -> None:
    """Names there are patterns, and no selectors with numbers."""
    made = scenario(programs=PROGRAMS, checks={"programs": {"a": "done", "shore": "running"}})
    assert made.spec.checks.programs == {"a": "done", "shore": "running"}
    assert yaml.safe_load(made.to_yaml())["checks"]["programs"] == {"a": "done", "shore": "running"}
    scenario(programs=PROGRAMS, checks={"programs": {"shore/gcs": "done", "*": "running"}})
    assert "there is no program shor" in mistakes(programs=PROGRAMS, checks={"programs": {"shor": "done"}})


def test_a_topic_of_ros_may_begin_with_a_slash() -> None:
    told = {"depth": {"of": "a", "message": "/a/depth", "ros": "data"}}
    assert scenario(signals=told).spec.signals is not None
    assert "zenoh takes no such key" in mistakes(signals={"depth": {"of": "a", "message": "/a/depth", "json": ""}})


SELECTORS = [
    ({"kill": "zz"}, "there is no node zz: the nodes are a, b, shore"),
    ({"mute": "7"}, "there is no node 7: the nodes are a, b, shore"),
    ({"partition": "zz / yy"}, "there is no node zz: the nodes are a, b, shore"),
    ({"partition": "a / 5"}, "there is no node 5: the nodes are a, b, shore"),
    ({"partition": "zz"}, '"zz" is no partition of a, b, shore'),
    ({"down": "zz->yy"}, '"zz->yy" is no link: write "*", "a->b", "a<->b", "a->*" or "*->b"'),
]


@pytest.mark.parametrize(("fault", "expected"), SELECTORS)
def test_a_wrong_selector_is_told_in_names(fault: dict[str, str], expected: str) -> None:
    """`kill zz` expected vehicle numbers such as "3", in a file and of the operator of a run that goes on."""
    programs = {"*": {"run": "x"}}
    assert expected in mistakes(programs=programs, faults=[{"at": "1 s"} | fault])
    with pytest.raises(RefusedError, match=re.escape(expected)):
        check_fault(fault, 1, scenario(programs=programs))


@pytest.mark.parametrize(
    ("sections", "expected"),
    [
        ({"checks": {"max_age": {"below": "1 s", "links": "zz->yy"}}}, "a->b"),
        ({"network": {"radios": {"zz": "rate 80kbit"}}}, "no node zz"),
        ({"network": {"links": {"zz->yy": "loss 3%"}}}, "a->b"),
        ({"signals": {"x": {"line": "(?P<value>.)"}}, "programs": {"*": {"run": "x"}},
          "checks": {"signal": {"topic": "x", "above": 0, "vehicles": "zz"}}}, "no node zz"),
    ],
)  # fmt: skip
def test_no_mistake_in_a_selector_speaks_of_vehicles(sections: dict[str, Any], expected: str) -> None:
    said = mistakes(**sections)
    assert expected in said and "vehicle n" not in said and "1->2" not in said


@pytest.mark.parametrize(
    ("place", "key", "expected"),
    [
        ({"topik": "a"}, "topik", 'did you mean "topic"?'),
        ({"topic": "a", "x": 1}, "x", "known here: topic"),
        ({}, "topic", ""),
        (5, "", "without a unit"),
        ("here", "", 'got "here"'),
        ([1, 2], "", "got a list"),
    ],
)
def test_a_wrong_place_is_one_mistake(place: Any, key: str, expected: str) -> None:
    """It may be a text or a topic, and a mistake in one was one in the other, too, and in places that nobody wrote."""
    (said,) = mistakes(nodes=NODES | {"a": {"listen": "tcp/127.0.0.1:1", "place": place}}).splitlines()
    assert said.startswith(f"nodes.a.place{f'.{key}' if key else ''}: ") and expected in said
