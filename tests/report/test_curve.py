"""The curve shows what was logged, where it was logged."""

import pytest
from PIL import Image

from marl_clean.errors import BadInput
from marl_clean.report.curve import draw_curve, panels, plot_curve
from marl_clean.report.metrics import read_metrics
from marl_clean.report.origin import Origin
from tests.report.reading import origin_of

ORIGIN = Origin("marl-clean train", ["ab"])

CSV = """frames,train/loss,train/coverage,validation/coverage,validation/T_90
0,,0.1,,
1000,0.5,0.4,0.3,90
2000,0.4,0.6,0.5,70
"""


def test_empty_cells_are_no_points(tmp_path):
    (tmp_path / "metrics.csv").write_text(CSV)
    columns = read_metrics(tmp_path / "metrics.csv")
    assert columns["train/loss"] == [(1000.0, 0.5), (2000.0, 0.4)]
    assert len(columns["train/coverage"]) == 3


def test_columns_of_one_thing_share_a_panel_and_the_result_comes_first(tmp_path):
    (tmp_path / "metrics.csv").write_text(CSV)
    columns = read_metrics(tmp_path / "metrics.csv")
    assert panels(list(columns)) == ["T_90", "coverage", "loss"]
    figure = plot_curve(columns, {"T_90": 47.0})
    coverage = next(axes for axes in figure.axes if axes.get_title(loc="left") == "coverage")
    assert [line.get_label() for line in coverage.get_lines()] == ["train", "validation"]
    assert coverage.get_lines()[1].get_ydata().tolist() == [0.3, 0.5]
    lines = figure.axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["validation", "nearest_unknown"]
    assert list(lines[1].get_ydata()) == [47.0, 47.0]


@pytest.mark.slow
def test_a_picture_is_written(tmp_path):
    (tmp_path / "metrics.csv").write_text(CSV)
    draw_curve(tmp_path / "metrics.csv", tmp_path / "curve.png", ORIGIN)
    assert origin_of(tmp_path / "curve.png") == ("marl-clean train", ["ab"])
    with Image.open(tmp_path / "curve.png") as picture:
        assert picture.width > picture.height > 200


@pytest.mark.parametrize("text", ["", "frames\n", "loss\n1\n", None])
def test_no_table_of_frames_is_bad_input(tmp_path, text):
    if text is not None:
        (tmp_path / "metrics.csv").write_text(text)
    with pytest.raises(BadInput, match="metrics.csv"):
        draw_curve(tmp_path / "metrics.csv", tmp_path / "curve.png", ORIGIN)
    assert not (tmp_path / "curve.png").exists()
