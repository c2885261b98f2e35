"""A crash at any filesystem call leaves what was there before, or what comes after."""

from collections.abc import Callable
from pathlib import Path

import pytest

from marl_clean.storage import files
from tests.reliability.crash_points import Broken, crash, save_and_prune, write_rows

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_crash_leaves_the_old_or_the_new() -> None:
    count = crash(every=8)
    assert set(count) == {"SIGKILL", "KeyboardInterrupt", "power cut"}
    assert count.total() > 100


def unflushed(path: Path, content: files.Content) -> files.Digest:
    path.write_bytes(b"".join(map(bytes, content)))
    return files.digest_of(path)


def file_in_place(path: Path, content: files.Content) -> files.Digest:
    with path.open("wb") as file:
        for piece in content:
            file.write(piece)
    return files.digest_of(path)


def half_removed(path: Path) -> None:
    files.shutil.rmtree(path)


@pytest.mark.parametrize(
    ("change", "name", "planted"),
    [
        (save_and_prune, "_write_flushed", unflushed),  # renamed before it is flushed
        (save_and_prune, "_flush", lambda folder: None),
        (save_and_prune, "remove_folder", half_removed),
        (write_rows, "write_file", file_in_place),
    ],
)
def test_a_write_that_a_crash_tears_is_seen(
    change: Callable[[Path], None],
    name: str,
    planted: Callable[..., object],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(files, name, planted)
    with pytest.raises(Broken, match="in part|neither"):
        crash([change], every=100)
