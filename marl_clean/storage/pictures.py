"""Pictures that were written, told from what a crash or a full disk has left of them."""

from pathlib import Path

WHOLE = {".png": (b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"), ".gif": (b"GIF8", b";")}
"""How a file of each kind begins and ends."""


def is_whole(path: Path) -> bool:
    """Whether there is a PNG or GIF at `path` that begins and ends as such a file does."""
    begins, ends = WHOLE[path.suffix]
    try:
        with path.open("rb") as file:
            head = file.read(len(begins))
            file.seek(max(0, file.seek(0, 2) - len(ends)))
            return head == begins and file.read() == ends
    except OSError:
        return False
