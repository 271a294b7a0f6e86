"""Reading the pages that commands write."""

from __future__ import annotations

import re
from html.parser import HTMLParser

TAGS = ("table", "figure", "svg", "div", "h2", "p", "pre", "details")


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "data")]
        self.open += [tag] if tag in TAGS else []

    def handle_endtag(self, tag: str) -> None:
        if self.open and tag == self.open[-1]:
            self.open.pop()


def check_page(text: str) -> list[str]:
    """Check that all elements are closed and nothing is fetched; return what the page embeds."""
    page = _Page()
    page.feed(text)
    assert page.open == []
    assert not re.search(r"(src|href)=.https?:|@import|url\(http", text)
    return page.sources
