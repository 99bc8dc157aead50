"""A flame graph: widths are time, names are escaped, narrow boxes are left out."""

from __future__ import annotations

from xml.etree import ElementTree

from flame_graph import MARGIN, WIDTH, Frame, flame_graph

SVG = "{http://www.w3.org/2000/svg}"
OUTER, INNER, OTHER = Frame("sea.advance", "world"), Frame("<lambda> & more", "world"), Frame("put", "zenoh")


def boxes(picture: str) -> dict[str, tuple[float, float, float]]:
    """By tooltip: left edge, bottom-up row and width."""
    found = {}
    for group in ElementTree.fromstring(picture).iter(f"{SVG}g"):
        title, box = group.find(f"{SVG}title"), group.find(f"{SVG}rect")
        assert title is not None and title.text is not None and box is not None
        found[title.text] = (float(box.attrib["x"]), float(box.attrib["y"]), float(box.attrib["width"]))
    return found


def test_boxes_are_as_wide_as_their_time_and_stand_on_their_callers() -> None:
    stacks = [((OUTER, INNER), 1.0), ((OUTER,), 1.0), ((OUTER, INNER), 1.0), ((OTHER,), 1.0)]
    found = boxes(flame_graph("a run", stacks))
    whole = WIDTH - 2 * MARGIN
    (_, low, put), (x, same, outer), (above, high, inner) = (
        found["put (zenoh): 1.00 s, 25.0%"],
        found["sea.advance (world): 3.00 s, 75.0%"],
        found["<lambda> & more (world): 2.00 s, 50.0%"],
    )
    assert (put, outer, inner) == (0.25 * whole, 0.75 * whole, 0.5 * whole)
    assert (low == same > high, above == x) == (True, True)


def test_what_is_too_narrow_is_left_out() -> None:
    found = boxes(flame_graph("a run", [((OUTER,), 999.0), ((OTHER,), 1.0)]))
    assert list(found) == ["sea.advance (world): 999.00 s, 99.9%"]


def test_each_kind_has_its_colour_and_stands_in_the_legend() -> None:
    picture = flame_graph("<a> & b", [((OUTER, OTHER, Frame("poll", "")), 1.0)])
    words = [element.text for element in ElementTree.fromstring(picture).iter(f"{SVG}text")]
    assert words[:3] == ["<a> & b", "world", "zenoh"]
    colours = {frame.colour for frame in (OUTER, OTHER, Frame("poll", ""))}
    assert len(colours) == 3 and all(f'fill="{colour}"' in picture for colour in colours)
