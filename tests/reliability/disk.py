"""What a power cut may leave of a folder: what was flushed, and any part of the rest.

A name that a folder was given or lost is on the disk for certain once the folder is flushed, and
what a file holds once the file is. Before, each may be there or not, of itself: the disk writes in
no order.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.reliability.calls import Call

Left = dict[str, bytes]
"""What files hold, by their paths; a folder's path ends with a slash."""


def write(left: Left, place: Path) -> None:
    """Make a folder `place` that holds what is left."""
    place.mkdir(parents=True)
    for name, content in left.items():
        if name.endswith("/"):
            (place / name).mkdir()
        else:
            (place / name).write_bytes(content)


@dataclass(eq=False)
class File:
    """What a file holds: now, and on the disk for certain."""

    now: bytes = b""
    flushed: bytes = b""


@dataclass(eq=False)
class Folder:
    """What a folder holds by name: now, and on the disk for certain."""

    now: "dict[str, File | Folder]" = field(default_factory=dict)
    flushed: "dict[str, File | Folder]" = field(default_factory=dict)


class Disk:
    """Follows the calls that change what is below `place`, which is on the disk when it begins."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.root = _as_it_is(place)

    def note(self, call: Call) -> None:
        """Follow a call, when it is done."""
        if not call.done:
            return
        path = Path(call.path)
        if call.name == "fsync":
            node = self._node(path)
            if isinstance(node, File):
                node.flushed = node.now = path.read_bytes()
            else:
                node.flushed = dict(node.now)
            return
        parent = self._folder(path.parent)
        if call.name == "mkdir":
            parent.now[path.name] = Folder()
        elif call.name == "open":
            parent.now[path.name] = File()
        elif call.name in ("write", "flush", "close"):
            if path.exists():
                self._file(path).now = path.read_bytes()
        elif call.name in ("rename", "replace"):
            target = Path(call.target or "")
            self._folder(target.parent).now[target.name] = parent.now.pop(path.name)
        else:
            del parent.now[path.name]

    def left(self, keeps: Callable[[], bool]) -> Left:
        """What a power cut leaves; `keeps` says of each change whether it is kept."""
        return dict(_left(self.root, "", keeps))

    def _node(self, path: Path) -> File | Folder:
        node: File | Folder = self.root
        for part in path.relative_to(self.place).parts:
            assert isinstance(node, Folder)
            node = node.now[part]
        return node

    def _folder(self, path: Path) -> Folder:
        node = self._node(path)
        assert isinstance(node, Folder)
        return node

    def _file(self, path: Path) -> File:
        node = self._node(path)
        assert isinstance(node, File)
        return node


def _as_it_is(place: Path) -> Folder:
    holds: dict[str, File | Folder] = {
        path.name: _as_it_is(path) if path.is_dir() else File(path.read_bytes(), path.read_bytes())
        for path in place.iterdir()
    }
    return Folder(dict(holds), dict(holds))


def _left(folder: Folder, inside: str, keeps: Callable[[], bool]) -> Iterator[tuple[str, bytes]]:
    for name in sorted(folder.now.keys() | folder.flushed.keys()):
        now, flushed = folder.now.get(name), folder.flushed.get(name)
        node = now if now is flushed or keeps() else flushed
        if isinstance(node, Folder):
            yield f"{inside}{name}/", b""
            yield from _left(node, f"{inside}{name}/", keeps)
        elif node is not None:
            kept = node.now if node.now == node.flushed or keeps() else node.flushed
            yield f"{inside}{name}", kept
