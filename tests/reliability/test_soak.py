"""To train, evaluate and report leaves nothing behind; `tests.reliability.soak` goes on longer."""

from pathlib import Path

import pytest

from tests.reliability import soak
from tests.reliability.soak import Broken

pytestmark = [pytest.mark.long, pytest.mark.usefixtures("unchecked", "one_thread")]


def test_cycles_leave_nothing_behind() -> None:
    assert soak.soak(0, least=6).startswith("6 cycles")


@pytest.mark.parametrize(
    ("kept", "seen"),
    [("memory", "memory grew"), ("file", "left: "), ("open", "open_files: ")],
)
def test_what_grows_is_seen(kept: str, seen: str) -> None:
    held: list[object] = []

    def work() -> None:
        if kept == "memory":
            held.append(bytearray(b"x" * 50_000_000))
        elif kept == "file":
            Path(f"left-{len(held)}").touch()
            held.append(None)
        else:
            held.append(Path("/dev/null").open("rb"))

    try:
        with pytest.raises(Broken, match=seen):
            soak.soak(0, work=work)
    finally:
        for each in held:
            if hasattr(each, "close"):
                each.close()
