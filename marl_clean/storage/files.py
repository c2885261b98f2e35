"""Atomic writes: a crash leaves the old content or the new, never a mixture.

A file or a folder is written under a hidden name beside its final one, flushed to the disk and
renamed; then the folder around it is flushed. What a crash leaves is a hidden name, which
`clear_leftovers` removes. Nothing here knows what is written.
"""

import errno
import hashlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from marl_clean.errors import BadInput

HIDDEN = ".partial-"
PIECE = 1 << 20


@dataclass(frozen=True)
class Digest:
    """The length of a file, and its sha256 in hex."""

    bytes: int
    sha256: str


Content = Iterable[bytes | memoryview]
Summarise = Callable[[dict[str, Digest]], bytes]


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say in one line what the disk refuses within this context, such as to hold more.

    Raises BadInput, which names `path`, in place of an OSError.
    """
    try:
        yield
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror}") from error


def make_folder(path: Path) -> None:
    """Make the folder `path`, and those around it, so that they survive a power cut."""
    missing = [place for place in (path, *path.parents) if not place.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for place in reversed(missing):
        _flush(place.parent)


def write_file(path: Path, content: Content) -> Digest:
    """Replace the file at `path` at once; an error leaves the old one as it was."""
    hidden = _hidden(path)
    try:
        digest = _write_flushed(hidden, content)
        os.replace(hidden, path)
    except BaseException:
        hidden.unlink(missing_ok=True)
        raise
    _flush(path.parent)
    return digest


def write_folder(
    path: Path, contents: Mapping[str, Content], summary: str, summarise: Summarise
) -> None:
    """Make the folder `path`, which must not exist, with all its files at once.

    The last file, named `summary`, holds what `summarise` makes of the others' digests.

    Raises:
        FileExistsError: there is something at `path`.
    """
    if path.exists():
        raise FileExistsError(errno.EEXIST, "exists already", str(path))
    hidden = _hidden(path)
    shutil.rmtree(hidden, ignore_errors=True)
    try:
        hidden.mkdir()
        digests = {
            name: _write_flushed(hidden / name, content) for name, content in contents.items()
        }
        _write_flushed(hidden / summary, [summarise(digests)])
        _flush(hidden)
        os.rename(hidden, path)
    except BaseException:
        shutil.rmtree(hidden, ignore_errors=True)
        raise
    _flush(path.parent)


def remove_folder(path: Path) -> None:
    """Remove a folder atomically: no crash leaves half of it under its name."""
    hidden = _hidden(path)
    shutil.rmtree(hidden, ignore_errors=True)
    os.rename(path, hidden)
    _flush(path.parent)  # else a power cut may undo the rename alone
    shutil.rmtree(hidden, ignore_errors=True)


def clear_leftovers(folder: Path) -> None:
    """Remove what crashes have left in `folder`."""
    for path in folder.glob(f"{HIDDEN}*"):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def digest_of(path: Path) -> Digest:
    """Read a file again and return its length and sha256."""
    digest, length = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            digest.update(piece)
            length += len(piece)
    return Digest(length, digest.hexdigest())


def _hidden(path: Path) -> Path:
    return path.with_name(f"{HIDDEN}{path.name}")


def _write_flushed(path: Path, content: Content) -> Digest:
    digest, length = hashlib.sha256(), 0
    with path.open("wb") as file:
        for piece in content:
            file.write(piece)
            digest.update(piece)
            length += len(piece)
        file.flush()
        os.fsync(file.fileno())
    return Digest(length, digest.hexdigest())


def _flush(folder: Path) -> None:
    """Flush a folder's list of names, without which a rename may not survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
