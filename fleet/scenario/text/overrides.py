"""The changes that options make to a scenario, on the tree before its validation.

So an override obeys the rules of the file, and a mistake in one is reported with those of the file.

| option | what it changes |
|---|---|
| `--set vehicles=N` | scales the scenario (see `scaling`), before the other overrides apply |
| `--set KEY=VALUE` | one key, such as `network.period`; steps into a list count from 1: `initial.2.surge=0.3 m/s` |
| `--set 'KEY."NAME".KEY=VALUE'` | a step with dots in it, such as the name of a node: `nodes."auv.1".place=0 0 5 m` |
| `--set network.links.SELECTOR.WORD=VALUES` | one word of a link's condition, such as `network.links.*.loss=30 %` |
| `--set network.links.SELECTOR.states.STATE.WORD=VALUES` | one word of the condition of one of its states |
| `--set network.links.SELECTOR.KEY=VALUE` | a key of states or a trace: `network.links.*.states.bad.mean=2 s` |
| `--net "SELECTOR CONDITION"` | `network.links`: in place of the same selector, behind all others, so that it wins |
| `--fault "at TIME ..."` | one fault more, in the words of `fault_words` |

`--show-config` shows the result.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from fleet.errors import Problem
from fleet.quantities import describe_value
from fleet.scenario.schema.network import LinkSection, LinkStateSection
from fleet.scenario.text.fault_words import FaultWordsError, fault_entry, link_entries
from fleet.scenario.text.scaling import scale
from fleet.scenario.text.yaml_reader import Items, Mapping, Node, Scalar, Source, TextPlace, plain, read
from netem.errors import TextError
from netem.grammar import WORDS, with_word
from netem.link_presets import link_presets
from netem.link_selector import parse_selector

SET, NET, FAULT = "--set", "--net", "--fault"
_MAX_STEPS = 10
_STEP = re.compile(r'"[^"]+"|[^."]+')
_PATH = re.compile(rf"(?:{_STEP.pattern})(?:\.(?:{_STEP.pattern}))*")
_LINK_WORD = re.compile(
    rf"network\.links\.(?P<selector>{_STEP.pattern})(?:\.states\.(?P<state>[^.]+))?\.(?P<word>[^.]+)"
)
_LINK_KEYS = {*LinkSection.model_fields, *LinkStateSection.model_fields}

Step = tuple[str, TextPlace]
Change = Callable[[Mapping], Mapping]


class Override(NamedTuple):
    """An option that changes a scenario, and its text.

    `typed` is what the user typed where that is another option, such as `--duration '20 s'` for `--set duration=20 s`.
    """

    option: str
    text: str
    typed: str = ""

    @property
    def name(self) -> str:
        """The override in problems."""
        return self.typed or f"{self.option} {self.text}"

    @classmethod
    def of(cls, text: str | Override) -> Override:
        """A text alone is one of `--set`."""
        return text if isinstance(text, Override) else cls(SET, text)


def apply(root: Mapping, overrides: Sequence[str | Override]) -> tuple[Mapping, list[Problem]]:
    """The tree with the overrides applied, and their mistakes.

    Those of `--set` are applied first; of each kind the later ones over the earlier.
    """
    problems: list[Problem] = []
    changes: list[Change] = []  # changes that --set asks for
    words: list[Change] = []
    for rank, override in enumerate(map(Override.of, overrides), start=1):
        source = Source(override.name, override.text, rank)
        if override.option != SET:
            words.append(partial(_with_links if override.option == NET else _with_fault, source))
            continue
        path, equals, _ = override.text.partition("=")
        steps = _steps(path, source)
        if not equals or not steps or len(steps) > _MAX_STEPS + 1:
            hint = "write key.path=value, such as network.period=50ms"
            problems.append(TextPlace(source, 1, 1).problem("not an override", hint))
            continue
        word = _LINK_WORD.fullmatch(path)
        if word and word["word"] not in _LINK_KEYS:
            changes.append(partial(_with_link_word, source))
            continue
        value, mistakes = read(source, start=len(path) + 1)
        problems += mistakes
        if value is None:
            continue
        if path == "vehicles":
            root = scale(root, root.with_entry("vehicles", TextPlace(source, 1, 1), value))
        else:
            changes.append(partial(_with_value, steps, value))
    for change in (*changes, *words):
        try:
            root = change(root)
        except FaultWordsError as error:
            problems.append(error.problem)
    return root, problems


def _steps(path: str, source: Source) -> list[Step]:
    """The steps of a path, between dots; one in quotes may have dots in it. Empty: it is no path."""
    if not _PATH.fullmatch(path):
        return []
    return [(found[0].strip('"'), TextPlace(source, 1, found.start() + 1)) for found in _STEP.finditer(path)]


def _with_value(steps: list[Step], value: Node, root: Mapping) -> Mapping:
    named = root.entries.get("agent")
    if len(steps) > 1 and steps[0][0] == "agent" and isinstance(named, Scalar) and isinstance(named.value, str):
        law = Mapping({"law": named}, {"law": named.place}, named.place)  # the name of a law alone is short for this
        root = root.with_entry("agent", root.keys["agent"], law)
    path = [key for key, _ in steps]
    # A number of some links does not put them over others, and a key of a node leaves it its number.
    keep = path[0] == "nodes" or (path[:2] == ["network", "links"] and len(path) > 3)
    changed = _set(root, steps, value, keep=keep)
    assert isinstance(changed, Mapping)  # there is at least one step
    return changed


def _set(node: Node | None, steps: list[Step], value: Node, *, keep: bool) -> Node:
    """A copy of `node` with `value` at the end of the steps; missing mappings are made on the way.

    `keep`: whether entries keep their place; otherwise those on the way become the last, which win where it matters.
    """
    if not steps:
        return value
    (key, place), rest = steps[0], steps[1:]
    if node is None or (isinstance(node, Scalar) and node.value is None):
        node = Mapping({}, {}, place)
    if isinstance(node, Mapping):
        changed = _set(node.entries.get(key), rest, value, keep=keep)
        if keep and key in node.entries:
            return Mapping(node.entries | {key: changed}, node.keys, node.place)
        return node.with_entry(key, place, changed)
    if isinstance(node, Items):
        index = int(key) if key.isascii() and key.isdigit() and len(key) < 6 else 0
        if not 1 <= index <= len(node.items):
            message = f'expected an entry of the list, from 1 to {len(node.items)}, got "{key}"'
            raise FaultWordsError(place.problem(message))
        items = list(node.items)
        items[index - 1] = _set(items[index - 1], rest, value, keep=keep)
        return Items(tuple(items), node.place)
    raise FaultWordsError(
        place.problem(f'there is no "{key}" here: the scenario has {describe_value(node.value)}, not a mapping')
    )


def _with_links(source: Source, root: Mapping) -> Mapping:
    """The tree with more conditions of links; a section that is wrong stays, and is reported when it is read."""
    entries, start = link_entries(source), TextPlace(source, 1, 1)
    root, links = _links(root, start)
    if links is None:
        return root
    for selector, condition in entries.entries.items():
        for same in [text for text in links.entries if _links_of(text) == _links_of(selector)]:
            links = links.without(same)
        links = links.with_entry(selector, entries.keys[selector], condition)
    return _place_value(root, ("network", "links"), start, links)


def _with_link_word(source: Source, root: Mapping) -> Mapping:
    """The tree with one word of a link's condition changed, which keeps its place among the others."""
    start = TextPlace(source, 1, 1)
    match = _LINK_WORD.fullmatch(source.text.partition("=")[0])
    assert match is not None
    selector, place = match["selector"].strip('"'), start.shift(match.start("selector"))
    root, links = _links(root, start)
    if links is None:
        return root
    same = next((text for text in links.entries if _links_of(text) == _links_of(selector)), None)
    if same is None and links.entries:
        known = ", ".join(links.entries)
        hint = "--net '* loss 30%' takes the place of all conditions of a link"
        message = f'network.links has no condition for "{selector}"; it has conditions for {known}'
        raise FaultWordsError(place.problem(message, hint))
    name = same or selector
    path: tuple[str, ...] = ("network", "links", name)
    before = links.entries.get(name)
    if isinstance(before, Mapping) and (preset := _preset(before)) is not None:
        before = preset
    if match["state"] is not None or isinstance(before, Mapping):
        before, path = _state_condition(match, name, before, place), (*path, "states", match["state"], "condition")
    text = "" if before is None else plain(before)
    if not isinstance(text, str):  # reported when it is read
        return root
    return _place_value(root, path, start if len(path) == 3 else place, _with_word(source, match, text))


def _preset(links: Mapping) -> Scalar | None:
    """The condition of links with a preset as its words; None: they have none, or an unknown one."""
    named = links.entries.get("preset")
    preset = link_presets().get(str(named.value)) if isinstance(named, Scalar) else None
    return None if preset is None else Scalar(preset.condition, links.place)


def _with_word(source: Source, match: re.Match[str], text: str) -> Scalar:
    """A condition with the word that an override changes."""
    start, word, value = TextPlace(source, 1, 1), match["word"], source.text[match.end() + 1 :]
    try:
        return Scalar(with_word(text, word, value), start.shift(match.end() + 1))
    except TextError as error:
        column = match.start("word") if not value.strip() or word not in WORDS else match.end() + 1 + error.column
        raise FaultWordsError(start.shift(column).problem(error.message, error.hint)) from None


def _state_condition(match: re.Match[str], name: str, links: Node | None, place: TextPlace) -> Node | None:
    """The condition in the state of the links `name` that an override at `place` names."""
    states = links.entries.get("states") if isinstance(links, Mapping) else None
    if not isinstance(states, Mapping):
        what = "a trace" if isinstance(links, Mapping) and "trace" in links.entries else "no states"
        raise FaultWordsError(
            place.problem(f'the links "{name}" have {what}, so there is no word of a state to change')
        )
    state = None if match["state"] is None else states.entries.get(match["state"])
    if not isinstance(state, Mapping):
        known = ", ".join(states.entries)
        hint = f"as in network.links.{name}.states.{next(iter(states.entries), 'bad')}.{match['word']}"
        raise FaultWordsError(place.problem(f'the links "{name}" have the states {known}: say which', hint))
    return state.entries.get("condition")


def _links(root: Mapping, start: TextPlace) -> tuple[Mapping, Mapping | None]:
    """The tree with a network that may get links, and its section of them; None: a section is wrong."""
    network = root.entries.get("network")
    if isinstance(network, Scalar) and network.value == "ideal":
        hint = "give it a period first, as in --set 'network={period: 100 ms}'"
        raise FaultWordsError(start.problem("the network of this scenario is ideal and has no links", hint))
    if isinstance(network, Scalar) and network.value == "acoustic":
        network = Mapping({"acoustic": Mapping({}, {}, network.place)}, {"acoustic": network.place}, network.place)
        root = root.with_entry("network", root.keys["network"], network)
    section = _mapping(network, start)
    return root, None if section is None else _mapping(section.entries.get("links"), start)


def _place_value(root: Mapping, path: Sequence[str], place: TextPlace, value: Node) -> Mapping:
    """The tree with a value at a path, whose entries keep their places; new ones are at `place`."""
    changed = _set(root, [(step, place) for step in path], value, keep=True)
    assert isinstance(changed, Mapping)  # there is at least one step
    return changed


def _mapping(node: Node | None, place: TextPlace) -> Mapping | None:
    """A section that may be left out or empty; None if it is something else."""
    if node is None or (isinstance(node, Scalar) and node.value is None):
        return Mapping({}, {}, place)
    return node if isinstance(node, Mapping) else None


def _links_of(selector: str) -> str:
    """The links of a selector, in any spelling; a text that is no selector stands for itself."""
    try:
        return str(parse_selector(selector))
    except TextError:
        return selector


def _with_fault(source: Source, root: Mapping) -> Mapping:
    """The tree with one fault more; faults that are no list stay, and are reported when they are read."""
    fault, start = fault_entry(source), TextPlace(source, 1, 1)
    if "at" not in fault.entries:
        raise FaultWordsError(start.problem("when does it begin?", "write at and a time in front, as in at 20s"))
    faults = root.entries.get("faults")
    if isinstance(faults, Mapping) or (isinstance(faults, Scalar) and faults.value is not None):
        return root
    before = faults.items if isinstance(faults, Items) else ()
    return root.with_entry("faults", root.keys.get("faults", start), Items((*before, fault), start))
