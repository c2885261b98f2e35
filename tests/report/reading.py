"""What can be read from figures: where they come from, and whether they can be read in grey."""

import xml.etree.ElementTree as ElementTree
from itertools import combinations
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

DUBLIN_CORE = "{http://purl.org/dc/elements/1.1/}"
LIGHTNESSES_APART = 10.0  # of 100: about the least step that is seen in print


def origin_of(path: Path) -> tuple[str, list[str]]:
    """The command and the config hashes that a figure's file holds."""
    if path.suffix == ".svg":
        tree = ElementTree.parse(path)
        source, about = (
            next(tree.iter(f"{DUBLIN_CORE}{name}")).text or "" for name in ("source", "identifier")
        )
        assert not list(tree.iter(f"{DUBLIN_CORE}date"))
    else:
        with Image.open(path) as picture:
            source, about = picture.info["Source"], picture.info["Identifier"]
    assert about.startswith("config sha256 ")
    return source, about.removeprefix("config sha256 ").split()


def lightness(colour: object) -> float:
    """CIE L* of a colour, 0 for black to 100: what is left of it in grey."""
    channels = np.array(to_rgb(colour))
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    luminance = float(linear @ [0.2126, 0.7152, 0.0722])
    return 116 * luminance ** (1 / 3) - 16 if luminance > 0.008856 else 903.3 * luminance


def form_of(line: Line2D) -> tuple[object, ...]:
    """What of a line can be seen in grey beside its lightness: dashes, mark, whether it is full."""
    mark = line.get_marker()
    return str(line._unscaled_dash_pattern), mark, line.get_fillstyle() if mark != "None" else ""


def alike_in_grey(figure: Figure) -> list[tuple[str, str]]:
    """Pairs of lines with different labels in one panel that grey does not keep apart."""
    pairs = []
    for axes in figure.axes:
        lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
        for one, other in combinations(lines, 2):
            apart = abs(lightness(one.get_color()) - lightness(other.get_color()))
            if form_of(one) == form_of(other) and apart < LIGHTNESSES_APART:
                pairs.append((str(one.get_label()), str(other.get_label())))
    return pairs


def covered_by_legends(figure: Figure) -> list[str]:
    """Labels of lines that run below a legend."""
    figure.draw_without_rendering()
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    assert legends
    boxes = [legend.get_window_extent() for legend in legends]
    return [
        str(line.get_label())
        for axes in figure.axes
        for line in axes.get_lines()
        for box in boxes
        if line.get_transform().transform_path(line.get_path()).intersects_bbox(box, filled=False)
    ]
