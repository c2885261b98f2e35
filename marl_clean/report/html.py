"""`report.html`: one page that holds all it shows; it asks nothing of any other machine."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files as package_files
from typing import Any

from marl_clean.report.origin import Origin
from marl_clean.report.plots import Plot, Rows
from marl_clean.report.recorded import Recording

ASSETS = package_files("marl_clean.report") / "page"
NOTHING = '<option value="">nothing</option>'
KEYS = (
    ("left, right", "a step back or on, with shift ten"),
    ("page up, page down", "ten steps"),
    ("home, end", "the first and the last step"),
    ("space", "play or pause"),
)


@dataclass(frozen=True)
class Part:
    """One part of the page: tables (a caption and rows, titles first) and plots."""

    title: str
    note: str = ""
    tables: Sequence[tuple[str, Rows]] = field(default=())
    plots: Sequence[Plot] = field(default=())


def render(
    title: str,
    notes: Sequence[str],
    parts: Sequence[Part],
    replays: Sequence[Recording],
    origin: Origin | None = None,
) -> str:
    """Return the page. Whatever comes from files is text in it, never markup.

    `origin`: what made the page, which each of its charts holds as metadata.
    """
    source = "" if origin is None else "\n".join(origin.metadata().values())
    names = [*(part.title for part in parts), *(["Replays"] if replays else [])]
    anchors = [f"part-{number}" for number in range(len(parts))] + ["replays"] * bool(replays)
    links = "".join(
        f'<li><a href="#{anchor}">{escape(name)}</a></li>'
        for anchor, name in zip(anchors, names, strict=True)
    )
    body = [
        f"<h1>{escape(title)}</h1>",
        *(f'<p class="note">{escape(note)}</p>' for note in notes),
        f'<nav aria-label="parts"><ul>{links}</ul></nav>',
        *(_part(part, anchor, source) for part, anchor in zip(parts, anchors, strict=False)),
        *([_replays(replays)] if replays else []),
    ]
    style = (ASSETS / "page.css").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:\">\n"
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


def _part(part: Part, anchor: str, source: str) -> str:
    plots = "".join(_plot(plot, source) for plot in part.plots)
    return "\n".join(
        [
            f'<section id="{anchor}"><h2>{escape(part.title)}</h2>',
            f'<p class="note">{escape(part.note)}</p>' if part.note else "",
            *(_table(rows, caption) for caption, rows in part.tables),
            f'<div class="plots">{plots}</div>' if plots else "",
            "</section>",
        ]
    )


def _plot(plot: Plot, source: str) -> str:
    numbers = _table(plot.numbers, plot.title)
    return (
        f"<figure><figcaption>{escape(plot.title)}</figcaption>"
        f"{plot.chart.svg(plot.title, source)}{plot.chart.legend()}"
        f"<details><summary>its numbers</summary>{numbers}</details></figure>"
    )


def _table(rows: Rows, caption: str) -> str:
    """A table; its first row holds titles, its first column names."""
    head, *body = rows
    titles = "".join(f'<th scope="col">{escape(title)}</th>' for title in head)
    lines = "".join(
        f'<tr><th scope="row">{escape(first)}</th>'
        + "".join(f"<td>{escape(cell)}</td>" for cell in rest)
        + "</tr>"
        for first, *rest in body
    )
    return (
        f'<div class="wide" tabindex="0"><table><caption><span>{escape(caption)}</span></caption>'
        f"<thead><tr>{titles}</tr></thead><tbody>{lines}</tbody></table></div>"
    )


def _replays(replays: Sequence[Recording]) -> str:
    options = "".join(
        f'<option value="{index}">{escape(replay["policy"])}</option>'
        for index, replay in enumerate(replays)
    )
    keys = "; ".join(f"{name}: {does}" for name, does in KEYS)
    script = (ASSETS / "player.js").read_text(encoding="utf-8")
    return (
        '<section id="replays"><h2>Replays</h2>'
        f'<p class="note">One episode in the first held-out house. Keys: {escape(keys)}.</p>'
        '<div class="player" tabindex="0" role="group" aria-label="replays">'
        '<div class="controls"><button type="button" class="play">play</button>'
        '<input type="range" min="0" max="0" value="0" aria-label="step">'
        '<a class="moment" href="#replay=0">link to this moment</a></div>'
        f'<div class="panels">{_panel(options, "left")}{_panel(NOTHING + options, "right")}</div>'
        '<p role="status" class="spoken"></p></div>'
        f'<script type="application/json" id="recordings">{as_script(replays)}</script>'
        f"<script>{script}</script></section>"
    )


def _panel(options: str, side: str) -> str:
    return (
        '<div class="panel"><label>policy '
        f'<select class="policy" aria-label="policy, {side}">{options}</select></label>'
        f'<div class="shown"><label>shows <select class="view" aria-label="shows, {side}"></select>'
        '</label><canvas class="house" role="img"></canvas>'
        '<canvas class="messages" role="img" aria-label="messages, a row a robot"></canvas>'
        '<p class="described"></p></div></div>'
    )


def as_script(data: Any) -> str:
    """JSON that cannot end the script element in which it stands."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
