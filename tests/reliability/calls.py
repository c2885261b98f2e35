"""Every filesystem call that writes, told before and after it is made.

Python's own files are watched where they are opened by a path's `open`, as all writing here is;
what reads is not told.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock


@dataclass(frozen=True)
class Call:
    """A call, and the paths that it is about; `done` is False before it and True after it."""

    name: str
    path: str
    target: str | None
    done: bool


Tell = Callable[[Call], None]


class _File:
    """An open file whose writing is told."""

    def __init__(self, file: Any, path: str, tell: Tell) -> None:
        self._file, self._path, self._tell = file, path, tell
        self._is_flushed = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> "_File":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def write(self, content: Any) -> Any:
        self._is_flushed = False
        with _told(self._tell, "write", self._path):
            return self._file.write(content)

    def flush(self) -> None:
        with _told(self._tell, "flush", self._path):
            self._file.flush()
        self._is_flushed = True

    def close(self) -> None:
        if self._file.closed:
            return
        try:
            if not self._is_flushed:
                self.flush()
            with _told(self._tell, "close", self._path):
                self._file.close()
        finally:
            self._file.close()


@contextmanager
def _told(tell: Tell, name: str, path: str, target: str | None = None) -> Iterator[None]:
    tell(Call(name, path, target, done=False))
    yield
    tell(Call(name, path, target, done=True))


@contextmanager
def told(tell: Tell) -> Iterator[None]:
    """Within this context `tell` is called before and after every call; it may raise or kill.

    What it calls itself is not told.
    """
    telling = False

    def tell_once(call: Call) -> None:
        nonlocal telling
        if telling:
            return
        telling = True
        try:
            tell(call)
        finally:
            telling = False

    with ExitStack() as stack:
        for name in ("mkdir", "rename", "replace", "unlink", "rmdir"):
            stack.enter_context(mock.patch.object(os, name, _of_paths(name, tell_once)))
        stack.enter_context(mock.patch.object(os, "fsync", _fsync(tell_once)))
        stack.enter_context(mock.patch.object(Path, "open", _open(tell_once)))
        yield


def _of_paths(name: str, tell: Tell) -> Callable[..., Any]:
    really = getattr(os, name)

    def call(path: Any, *more: Any, **kwargs: Any) -> Any:
        folder = kwargs.get("dir_fd")
        inside = "" if folder is None else _path_of(folder)
        target = os.fspath(more[0]) if name in ("rename", "replace") else None
        with _told(tell, name, os.path.join(inside, os.fspath(path)), target):
            return really(path, *more, **kwargs)

    return call


def _fsync(tell: Tell) -> Callable[[int], None]:
    really = os.fsync

    def fsync(descriptor: int) -> None:
        with _told(tell, "fsync", _path_of(descriptor)):
            really(descriptor)

    return fsync


def _open(tell: Tell) -> Callable[..., Any]:
    really = Path.open

    def open_path(path: Path, mode: str = "r", *more: Any, **kwargs: Any) -> Any:
        if mode.startswith("r"):
            return really(path, mode, *more, **kwargs)
        tell(Call("open", str(path), None, done=False))
        file = really(path, mode, *more, **kwargs)
        with ExitStack() as stack:
            stack.callback(file.close)
            tell(Call("open", str(path), None, done=True))
            stack.pop_all()
        return _File(file, str(path), tell)

    return open_path


def _path_of(descriptor: int) -> str:
    return os.readlink(f"/proc/self/fd/{descriptor}")
