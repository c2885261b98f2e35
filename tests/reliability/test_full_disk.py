"""A full disk ends a training with one line, damages nothing, and is forgotten with space again."""

import errno
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
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

CURVES, ROWS, CANNOT = "tensorboard", "metrics.csv", "cannot be written"
pytestmark = pytest.mark.usefixtures("unchecked", "one_thread")


@pytest.mark.long
def test_a_full_disk_is_one_line_and_loses_nothing(iql: Training) -> None:
    assert "No space left on device" in fill(iql, full_from(under("state-000000000016", 5)))
    assert "File too large" in fill(iql, limited_to(5_000))


def test_rows_that_cannot_be_written_name_their_file(tmp_path: Path) -> None:
    for number in range(10):
        with full_from(under(ROWS, number)):
            refused = refused_by(Csv, tmp_path / str(number))
        assert refused == f"{tmp_path / str(number) / ROWS}: {CANNOT}: {os.strerror(errno.ENOSPC)}"


def test_curves_that_cannot_be_written_name_their_folder_and_print_no_traceback(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for size in (0, 10, 100, 150, 200, 250):  # from the first event on, in one row after the other
        with restored(resource.RLIMIT_FSIZE), limited_to(size):
            refused = refused_by(TensorBoard, tmp_path / str(size))
        assert refused == f"{tmp_path / str(size) / CURVES}: {CANNOT}: {os.strerror(errno.EFBIG)}"
    assert capfd.readouterr().err == ""


def refused_by(make: Callable[[Path], Logger], folder: Path) -> str:
    """What a logger says, of whose files there is no place for all."""
    logger = make(folder)
    folder.mkdir()
    with pytest.raises(BadInput) as caught:
        logger.resume(0)
        for frames in range(10):
            logger.log(frames, {"loss": 0.5})
    with suppress(BadInput):
        logger.close()
    return str(caught.value)


@contextmanager
def restored(limit: int) -> Iterator[None]:
    before = resource.getrlimit(limit)
    yield
    resource.setrlimit(limit, before)


@pytest.mark.long
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
