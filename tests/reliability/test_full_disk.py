"""A full disk ends a training with one line, damages nothing, and is forgotten with space again."""

from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path

import pytest

from marl_clean.errors import BadInput
from marl_clean.logger.base import Logger
from marl_clean.logger.csv import Csv
from marl_clean.logger.tensorboard import TensorBoard
from marl_clean.storage import files
from tests.reliability.forks import Broken
from tests.reliability.full_disk import fill, full_from, limited_to, under
from tests.reliability.kills import Training

CURVES, ROWS = "tensorboard", "metrics.csv"
pytestmark = pytest.mark.usefixtures("unchecked", "one_thread")


@pytest.mark.slow
def test_a_full_disk_is_one_line_and_loses_nothing(iql: Training) -> None:
    assert "No space left on device" in fill(iql, full_from(under("state-000000000016", 5)))
    assert "File too large" in fill(iql, limited_to(5_000))


@pytest.mark.parametrize(("make", "name"), [(Csv, ROWS), (TensorBoard, CURVES)])
def test_a_logger_says_which_file_cannot_be_written(
    make: Callable[[Path], Logger], name: str, tmp_path: Path
) -> None:
    for number in range(10):
        logger = make(tmp_path / str(number))
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        with full_from(under(name, number)):
            with pytest.raises(BadInput) as caught:
                logger.resume(0)
                for frames in range(4):
                    logger.log(frames, {"loss": 0.5})
            with suppress(BadInput):
                logger.close()
        assert str(caught.value) == f"{path}: cannot be written: No space left on device"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "planted", "seen"),
    [
        ("writing", lambda path: nullcontext(), "OSError"),
        ("write_folder", None, "is unreadable"),
    ],
)
def test_a_full_disk_that_is_not_told_or_tears_a_checkpoint_is_seen(
    iql: Training,
    name: str,
    planted: Callable[..., object] | None,
    seen: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(files, name, planted or in_place)
    within = full_from(under(ROWS if planted else "state-000000000016", 6))
    with pytest.raises(Broken, match=seen):
        fill(iql, within)


def in_place(path: Path, contents: dict, summary: str, summarise: files.Summarise) -> None:
    path.mkdir()
    digests = {name: files._write_flushed(path / name, each) for name, each in contents.items()}
    files._write_flushed(path / summary, [summarise(digests)])
