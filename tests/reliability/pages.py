"""Names that are scripts, in every place of a page: `python -m tests.reliability.pages`.

A page whose names, texts, plots, tables and replays are called by a payload is parsed, and must
have the elements and attributes of its twin with harmless names. No attribute, style or script of
it may name another machine. No browser is needed; `tests.report.test_page` asks one.
"""

import re
import sys
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from itertools import zip_longest

from marl_clean.report.chart import Axis, Chart
from marl_clean.report.html import Part, render
from marl_clean.report.origin import Origin
from marl_clean.report.plots import Plot
from tests.report.test_page import PAYLOADS

HARMLESS = "name"
OUTSIDE = re.compile(r"(?:[a-z]+:)?//|@import|url\(|fetch\(|XMLHttpRequest|WebSocket|sendBeacon")
NAMESPACE = "http://www.w3.org/"  # names a language, and is never asked for


class Broken(AssertionError):
    """A promise that did not hold."""


class Elements(HTMLParser):
    """The elements of a page in their order, and what could make it ask another machine."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, ...]] = []
        self.asks: list[str] = []
        self.inside = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, *(name for name, _ in attributes)))
        self.inside = tag
        for name, value in attributes:
            is_asked_for = name in ("src", "href", "action", "style", "data", "srcset", "poster")
            if is_asked_for and OUTSIDE.search(value or ""):
                self.asks.append(f"<{tag} {name}={value}>")

    def handle_endtag(self, tag: str) -> None:
        self.elements.append((f"/{tag}",))
        self.inside = ""

    def handle_data(self, data: str) -> None:
        if self.inside == "style" and OUTSIDE.search(data):
            self.asks.append(data[:200])

    def handle_comment(self, data: str) -> None:
        self.elements.append(("comment",))


def page_of(name: str, draw: Callable[..., str] = render) -> str:
    """A page on which everything that a file can name has this name."""
    chart = Chart(Axis(name), Axis(names=[name]), names={0: name})
    chart.line(0, [0, 1], [1, 0], title=name)
    plot = Plot(name, chart, [[name] * 2] * 2)
    parts = [Part(name, name, [(name, [[name] * 2] * 2)], [plot])]
    replays = [{"policy": name, "house": name, "config": {name: name}}]
    return draw(name, [name], parts, replays, Origin(name, [name]))


def check(payloads: Sequence[str] = PAYLOADS, draw: Callable[..., str] = render) -> str:
    """Compare a page for each payload with its twin; return a line of what was seen.

    Raises Broken where an element differs, or the page asks anybody.
    """
    twin = Elements(page_of(HARMLESS, draw))
    for payload in payloads:
        page = Elements(page_of(payload, draw))
        for own, other in zip_longest(page.elements, twin.elements):
            if own != other:
                raise Broken(f"{payload!r} makes {own} of {other}")
        if asks := [ask for ask in page.asks if NAMESPACE not in ask]:
            raise Broken(f"{payload!r}: asks for {asks[0]}")
    return (
        f"{len(payloads)} names that are scripts: 0 of {len(twin.elements)} elements differ, 0"
        " requests to other machines"
    )


def main() -> None:
    sys.stdout.write(check() + "\n")


if __name__ == "__main__":
    main()
