"""Charts are well-formed, in the viewer's colours, and points stand where their numbers say."""

import math
import re
from xml.etree import ElementTree

import pytest

from marl_clean.env.viewer import ROBOTS
from marl_clean.report.chart import Axis, Chart, Kind, nice_step, shown
from marl_clean.report.html import ASSETS

SVG = {"svg": ""}


def drawn(chart: Chart) -> ElementTree.Element:
    return ElementTree.fromstring(chart.svg('<b>"T_90"&'))


def paths(root: ElementTree.Element, kind: str) -> list[list[float]]:
    """The numbers of each path of a kind."""
    found = [path for path in root.iter("path") if kind in path.get("class", "").split()]
    return [[float(n) for n in re.findall(r"-?\d+\.?\d*", path.get("d", ""))] for path in found]


def tick_places(root: ElementTree.Element, of: str) -> dict[float, float]:
    """The pixels of an axis' labels by their numbers."""
    place = {"x": "x", "y": "y"}[of]
    texts = [text for text in root.iter("text") if text.get("class") == of and text.get(place)]
    numbers = [text for text in texts if re.fullmatch(r"-?[\d.]+", text.text or "")]
    return {float(text.text or ""): float(text.get(place, "")) for text in numbers}


def test_points_stand_between_the_ticks_where_their_numbers_say() -> None:
    chart = Chart(Axis("steps", low=0), Axis("share"))
    chart.line(0, [100, 300], [2, 7])
    root = drawn(chart)
    [[x0, y0, x1, y1]] = paths(root, "line")
    for of, ends, values in (("x", (x0, x1), (100, 300)), ("y", (y0, y1), (2, 7))):
        ticks = tick_places(root, of)
        (low, at_low), *_, (high, at_high) = sorted(ticks.items())
        for end, value in zip(ends, values, strict=True):
            share = (value - low) / (high - low)
            assert end == pytest.approx(at_low + share * (at_high - at_low), abs=0.11)
    assert y1 < y0  # more is higher


def test_a_named_axis_has_its_first_name_on_top() -> None:
    chart = Chart(Axis(low=0), Axis(names=["T_90", "T_100"]))
    chart.line(0, [5], [0], Kind.POINT)
    chart.line(0, [5], [1], Kind.POINT)
    root = drawn(chart)
    first, second = (path[1] for path in paths(root, "point"))
    labels = [text for text in root.iter("text") if text.get("class") == "y"]
    assert [text.text for text in labels] == ["T_90", "T_100"]
    assert [float(text.get("y", "")) for text in labels] == [first, second] and first < second


def test_a_band_has_gaps_where_there_is_no_interval() -> None:
    chart = Chart(Axis(), Axis())
    nan = math.nan
    chart.band(0, [0, 1, 2, 3, 4], [0, 1, nan, 2, 2], [1, 2, nan, 3, 3])
    assert [len(path) for path in paths(drawn(chart), "band")] == [8, 8]
    nothing = Chart(Axis(), Axis())
    nothing.band(0, [0], [nan], [nan])
    nothing.line(0, [], [])
    nothing.line(0, [1], [nan])
    assert paths(drawn(nothing), "band") == paths(drawn(nothing), "line") == []


def test_what_comes_from_files_is_text() -> None:
    chart = Chart(Axis("<x>"), Axis(names=["<y>&"]), names={0: "<script>"})
    chart.line(0, [1, 2], [0, 0], title='"<img>')
    root = drawn(chart)
    texts = {text.text for text in root.iter() if text.text}
    assert {"<x>", "<y>&", '"<img>'} <= texts and root.get("aria-label") == '<b>"T_90"&'
    assert "&lt;script&gt;" in chart.legend() and "<script>" not in chart.legend()


@pytest.mark.parametrize("values", [[5.0], [5.0, 5.0], [0.0], []])
def test_a_chart_of_one_value_or_none_is_drawn(values: list[float]) -> None:
    for low in (None, 0):
        chart = Chart(Axis(low=low), Axis(low=low))
        if values:
            chart.line(0, values, values)
        assert "nan" not in chart.svg("title") and drawn(chart) is not None


def test_lines_differ_in_grey_and_no_two_rows_look_alike() -> None:
    chart = Chart(Axis(), Axis(), names={row: str(row) for row in range(64)})
    classes = re.findall(r'<li><svg class="(c\d) (d\d)"', chart.legend())
    assert len(set(classes)) == 64 and len({dashes for _, dashes in classes[:8]}) == 8


@pytest.mark.parametrize(("least", "step"), [(0.03, 0.05), (1, 1), (1.2, 2), (21, 25), (260, 500)])
def test_steps_between_ticks_are_round(least: float, step: float) -> None:
    assert nice_step(least) == pytest.approx(step)


@pytest.mark.parametrize(
    ("value", "step", "text"),
    [(0, 5, "0"), (0.30000000000000004, 0.1, "0.3"), (2500, 500, "2.5k"), (3e6, 1e6, "3M")],
)
def test_labels_are_short(value: float, step: float, text: str) -> None:
    assert shown(value, step) == text


def test_the_page_has_the_viewers_colours() -> None:
    css = (ASSETS / "page.css").read_text(encoding="utf-8")
    light = css.partition("@media")[0]
    for index, colour in enumerate(ROBOTS):
        assert f"--c{index}: #{bytes(colour).hex()};" in light
        assert len(re.findall(rf"--c{index}:", css)) == 2  # on light and on dark paper


def luminance(colour: str) -> float:
    """Of `#rrggbb`, as WCAG 2 defines it."""
    parts = [part / 255 for part in bytes.fromhex(colour.removeprefix("#"))]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("paper", ["light", "dark"])
def test_text_and_lines_have_contrast(paper: str) -> None:
    """WCAG 2 AA: 4.5 for text, 3 for what is drawn."""
    css = (ASSETS / "page.css").read_text(encoding="utf-8")
    light, _, rest = css.partition("@media (prefers-color-scheme: dark)")
    palette = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", light if paper == "light" else rest))
    least = {"ink": 4.5, "faint": 4.5, "link": 4.5, **{f"c{row}": 3.0 for row in range(8)}}
    for ground in ("paper", "panel"):
        for name, ratio in least.items():
            ends = sorted(luminance(palette[each]) + 0.05 for each in (name, ground))
            assert ends[1] / ends[0] >= ratio, (paper, ground, name)
