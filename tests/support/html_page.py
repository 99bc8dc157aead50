"""A page as a browser reads it."""

from __future__ import annotations

from html.parser import HTMLParser


class Page(HTMLParser):
    """The elements of a page with their attributes, what it would load, and its words; every element closes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []
        assert {tag for tag, _ in self.tags}.isdisjoint({"script", "link", "iframe", "object"})

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br", "link"):
            self._open.append(tag)
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open[-1:] != ["style"]:
            self.words.append(data)

    @property
    def loads(self) -> list[str]:
        names = ("src", "href", "data", "srcset", "action")
        return [str(found[name]) for _, found in self.tags for name in names if name in found]


def words_of(page: str) -> str:
    """The words of a page, with bars where elements or lines end."""
    words = (word.strip() for data in Page(page).words for word in data.split("\n"))
    return " | ".join(word for word in words if word)
