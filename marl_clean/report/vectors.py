"""Figures as vectors inside a page, in the page's own colours: readable on light and dark paper."""

import io
import re

import matplotlib
from matplotlib.figure import Figure

from marl_clean.report.axes import STYLE

# Colours that stand for those of the page until the figure is text; drawn nowhere else.
INK, LINE = "#010203", "#040506"
OF_PAGE = {INK: "var(--ink)", LINE: "var(--line)"}
PAGE_STYLE = {
    **STYLE,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": LINE,
    "grid.linewidth": 0.6,
    "axes.grid": True,
    "font.family": "sans-serif",
}
PROLOGUE = re.compile(r"^.*?(?=<svg)|<metadata>.*?</metadata>", re.DOTALL)
IDS = re.compile(r'((?:id="|xlink:href="#|url\(#))')


def as_vectors(figure: Figure, name: str) -> str:
    """Return the figure as an `<svg>` element for a page.

    `name` comes first in all of its ids, so that several figures can stand in one page.
    """
    content = io.StringIO()
    with matplotlib.rc_context(PAGE_STYLE):
        figure.savefig(content, format="svg", metadata={"Date": None})
    text = PROLOGUE.sub("", content.getvalue())
    text = IDS.sub(rf"\g<1>{name}-", text)
    for colour, variable in OF_PAGE.items():
        text = text.replace(colour, variable)
    return text.replace("<svg ", '<svg role="img" aria-hidden="true" ', 1)
