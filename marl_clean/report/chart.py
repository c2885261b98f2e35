"""Charts of lines and points as SVG text, in the page's own colours.

A page of many worlds has a hundred of them: each is written in a millisecond, and weighs what its
points do. Colours, widths and dashes are classes of page.css, which knows light and dark paper.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from html import escape

from marl_clean.env.viewer import ROBOTS

WIDTH, HEIGHT = 340, 230  # pixels at the smallest width of a column
RIGHT, TOP, BOTTOM = 12, 8, 38  # margins
LETTER = 6.2  # pixels that a letter of a tick's label takes
TICKS = 5  # at most, on an axis of numbers
NICE = (1, 2, 2.5, 5, 10)  # steps between ticks, of a power of ten
Number = int | float
PLACES = {1e9: "G", 1e6: "M", 1e3: "k"}
SHAPES = (  # of points, around where the pen stands
    "m-3.2 0a3.2 3.2 0 1 0 6.4 0a3.2 3.2 0 1 0-6.4 0z",
    "m-2.8-2.8h5.6v5.6h-5.6z",
    "m0-3.8l3.5 6.2h-7z",
    "m0-4l4 4l-4 4l-4-4z",
    "m0 3.8l3.5-6.2h-7z",
    "m-3.8 0l6.2 3.5v-7z",
    "m3.8 0l-6.2 3.5v-7z",
    "m-1.2-3.6h2.4v2.4h2.4v2.4h-2.4v2.4h-2.4v-2.4h-2.4v-2.4h2.4z",
)


class Kind(Enum):
    """What a mark is: a class of page.css."""

    LINE = "line"
    SPAN = "span"  # an interval
    THIN = "thin"  # a line of a single seed
    BAND = "band"
    POINT = "point"
    SEED = "seed"  # a small point


@dataclass(frozen=True)
class Axis:
    """One axis; ends that are None are those of what is drawn.

    `names` label the places 0, 1, ..., of which 0 is on top of a vertical axis; `zero`: 0 is shown,
    with a line of its own.
    """

    label: str = ""
    low: Number | None = None
    high: Number | None = None
    names: Sequence[str] = ()
    zero: bool = False


@dataclass(frozen=True)
class _Mark:
    kind: Kind
    row: int
    points: Sequence[tuple[Number, Number]]
    title: str


@dataclass
class Chart:
    """A chart of rows, each with the colour, the dashes and the shape of its index."""

    x: Axis
    y: Axis
    height: Number = HEIGHT
    names: dict[int, str] = field(default_factory=dict)  # of rows, for the legend
    _marks: list[_Mark] = field(default_factory=list)

    def line(
        self,
        row: int,
        xs: Sequence[Number],
        ys: Sequence[Number],
        kind: Kind = Kind.LINE,
        title: str = "",
    ) -> None:
        """Add a line or points, in place; it has gaps where there are NaN.

        `title` is what a pointer resting there shows.
        """
        for piece in _pieces(list(zip(xs, ys, strict=True))):
            self._marks.append(_Mark(kind, row, [(x, y) for x, y in piece], title))

    def band(
        self, row: int, xs: Sequence[Number], low: Sequence[Number], high: Sequence[Number]
    ) -> None:
        """Add an area between two lines, in place; it has gaps where they are NaN."""
        for piece in _pieces(list(zip(xs, low, high, strict=True))):
            edge = [(x, top) for x, _, top in piece] + [(x, end) for x, end, _ in piece[::-1]]
            self._marks.append(_Mark(Kind.BAND, row, edge, ""))

    def svg(self, title: str, origin: str = "") -> str:
        """The chart as an `<svg>` element without its legend; `origin` is its metadata."""
        points = [point for mark in self._marks for point in mark.points]
        x_ticks, y_ticks = (
            _ticks(axis, [point[place] for point in points])
            for place, axis in enumerate((self.x, self.y))
        )
        left = 8 + LETTER * max(len(text) for _, text in y_ticks.labels) + 16 * bool(self.y.label)
        right, bottom = WIDTH - RIGHT, self.height - BOTTOM
        x = _Scale(x_ticks.low, x_ticks.high, left, right)
        top_down = bool(self.y.names)
        y = _Scale(y_ticks.low, y_ticks.high, *((TOP, bottom) if top_down else (bottom, TOP)))
        parts = [
            f'<svg role="img" aria-label="{escape(title)}" viewBox="0 0 {WIDTH} {self.height:g}">'
        ]
        parts += [f"<metadata>{escape(origin)}</metadata>"] if origin else []
        for value, text in x_ticks.labels:
            at = _short(x(value))
            parts.append(f'<path class="grid" d="M{at} {TOP}V{_short(bottom)}"/>')
            parts.append(
                f'<text x="{at}" y="{_short(bottom + 14)}" class="x">{escape(text)}</text>'
            )
        if self.x.zero:
            parts.append(f'<path class="axis" d="M{_short(x(0))} {TOP}V{_short(bottom)}"/>')
        for value, text in y_ticks.labels:
            at = _short(y(value))
            parts.append(f'<path class="grid" d="M{_short(left)} {at}H{right}"/>')
            parts.append(
                f'<text x="{_short(left - 5)}" y="{at}" dy=".35em" class="y">{escape(text)}</text>'
            )
        parts.append(f'<path class="axis" d="M{_short(left)} {TOP}V{_short(bottom)}H{right}"/>')
        parts += [_drawn(mark, x, y) for mark in self._marks]
        middle = _short((left + right) / 2)
        parts.append(
            f'<text x="{middle}" y="{_short(self.height - 8)}" class="x">{escape(self.x.label)}'
            "</text>"
        )
        if self.y.label:
            at = _short((TOP + bottom) / 2)
            parts.append(
                f'<text transform="translate(12 {at}) rotate(-90)" class="x">'
                f"{escape(self.y.label)}</text>"
            )
        return "".join([*parts, "</svg>"])

    def legend(self) -> str:
        """The rows' names with their lines and shapes, as a list."""
        items = "".join(
            f'<li><svg class="{_classes(row)}" viewBox="0 0 36 10" aria-hidden="true">'
            f'<path class="line" d="M0 5h36"/><path class="point" d="M18 5{_shape(row)}"/></svg>'
            f"{escape(name)}</li>"
            for row, name in self.names.items()
        )
        return f'<ul class="legend">{items}</ul>'


@dataclass(frozen=True)
class _Ticks:
    low: Number
    high: Number
    labels: Sequence[tuple[Number, str]]


@dataclass(frozen=True)
class _Scale:
    """From values to pixels."""

    low: Number
    high: Number
    start: Number
    end: Number

    def __call__(self, value: Number) -> float:
        share = (value - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)


def _ticks(axis: Axis, values: Sequence[Number]) -> _Ticks:
    if axis.names:
        return _Ticks(-0.5, len(axis.names) - 0.5, list(enumerate(axis.names)))
    values = [*values, 0] if axis.zero else values
    low = axis.low if axis.low is not None else min(values, default=0.0)
    high = axis.high if axis.high is not None else max(values, default=1.0)
    if high <= low:
        low, high = (low, low + 1) if axis.low is not None else (low - 0.5, low + 0.5)
    room = 0.04 * (high - low)  # marks at the ends are whole
    low = low if axis.low is not None else low - room
    high = high if axis.high is not None else high + room
    step = nice_step((high - low) / TICKS)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return _Ticks(low, high, [(k * step, shown(k * step, step)) for k in range(first, last + 1)])


def nice_step(least: Number) -> float:
    """The smallest of 1, 2, 2.5, 5 times a power of ten that is at least `least`."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(nice * power for nice in NICE if nice * power >= least * (1 - 1e-9))


def shown(value: Number, step: Number) -> str:
    """A tick's label: 0.25, 400, 12.5k, 3M."""
    for size, letter in PLACES.items():
        if abs(value) >= size and step >= size / 1000:
            return f"{value / size:.6g}{letter}"
    return f"{value:.6g}"


def _pieces(points: Sequence[tuple[Number, ...]]) -> Iterator[Sequence[tuple[Number, ...]]]:
    """Stretches without NaN."""
    piece: list[tuple[Number, ...]] = []
    for point in points:
        if any(map(math.isnan, point)):
            if piece:
                yield piece
            piece = []
        else:
            piece.append(point)
    if piece:
        yield piece


def _drawn(mark: _Mark, x: _Scale, y: _Scale) -> str:
    places = [f"{_short(x(a))} {_short(y(b))}" for a, b in mark.points]
    match mark.kind:
        case Kind.POINT:
            path = "".join(f"M{place}{_shape(mark.row)}" for place in places)
        case Kind.SEED:
            path = "".join(f"M{place}h0" for place in places)  # round ends make it a dot
        case Kind.BAND:
            path = f"M{'L'.join(places)}z"
        case Kind.LINE | Kind.SPAN | Kind.THIN:
            path = f"M{'L'.join(places)}" if len(places) > 1 else f"M{places[0]}h0"
    title = f"<title>{escape(mark.title)}</title>" if mark.title else ""
    return f'<path class="{mark.kind.value} {_classes(mark.row)}" d="{path}">{title}</path>'


def _classes(row: int) -> str:
    """Colour and dashes. In grey, colours of one lightness are one: so lines differ in both."""
    return f"c{row % len(ROBOTS)} d{_second(row)}"


def _shape(row: int) -> str:
    return SHAPES[_second(row)]


def _second(row: int) -> int:
    """Of dashes and shapes, another one for rows that share a colour."""
    return (row + row // len(ROBOTS)) % len(SHAPES)


def _short(pixels: Number) -> str:
    """A tenth of a pixel is seen by nobody."""
    return f"{pixels:.1f}".removesuffix(".0")
