"""A crash at every filesystem call: `python -m tests.reliability.crash_points`.

Each of the `CHANGES` to a run's folder is done again and again, and crashes before and after each
of its filesystem calls in turn: by SIGKILL, in a fork; by KeyboardInterrupt; and by a power cut,
which loses what was not flushed. Of the last there are several for each call, since the disk may
have kept any part of that (see `Disk`). Then the folder must hold what it held before the change
or what it holds after it, and the same change, made again, must leave nothing more.
"""

import os
import random
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from marl_clean.storage import files, manifest
from marl_clean.storage.checkpoint import Checkpoints
from tests.reliability.calls import Call, told
from tests.reliability.disk import Disk, Left, write

KEPT = (0.0, 1.0, 0.3, 0.7)  # of what a power cut may take, the share by chance that it leaves
POWER_CUT = "power cut"
ROWS = "metrics.csv"


def tree(frames: int) -> dict[str, Any]:
    return {"x": torch.full((300,), float(frames)), "frames": frames}


def save_first(folder: Path) -> None:
    """Save the first state of a run, whose folder there is not yet."""
    files.make_folder(folder)
    Checkpoints(folder / manifest.FOLDER).save("state", 1, tree(1), {})


def save_and_prune(folder: Path) -> None:
    """Save the third state, which removes the first."""
    Checkpoints(folder / manifest.FOLDER).save("state", 3, tree(3), {})


def forget(folder: Path) -> None:
    """Go back to the first state."""
    Checkpoints(folder / manifest.FOLDER).forget_after(1)


def finish(folder: Path) -> None:
    """Save the last weights, and remove the states."""
    checkpoints = Checkpoints(folder / manifest.FOLDER)
    checkpoints.save("final", 2, tree(2), {})
    checkpoints.remove("state")


def write_rows(folder: Path) -> None:
    """Replace a file."""
    files.clear_leftovers(folder)
    files.write_file(folder / ROWS, [b"frames\n", b"1\n", b"2\n"])


Change = Callable[[Path], None]
CHANGES = (save_first, save_and_prune, forget, finish, write_rows)


class Broken(AssertionError):
    """A crash after which neither the old nor the new is there."""


class Crash(KeyboardInterrupt):
    """Ends a change at once, as Ctrl-C can."""


def before(folder: Path, change: Change) -> None:
    """Make what `change` begins with."""
    if change is save_first:
        return
    checkpoints = Checkpoints(folder / manifest.FOLDER)
    for frames in (1, 2):
        checkpoints.save("state", frames, tree(frames), {})
    files.write_file(folder / ROWS, [b"frames\n", b"1\n"])


def held(folder: Path) -> dict[str, Any]:
    """What a run goes on with: its last weights, else its newest state; and its rows.

    Raises Broken where a checkpoint is there in part.
    """
    place = folder / manifest.FOLDER
    for path in manifest.paths(place):
        try:
            manifest.verify(path)
        except manifest.Damaged as error:
            raise Broken(f"{path.name} is there in part: {error}") from error
    newest = Checkpoints(place).newest("final") or Checkpoints(place).newest("state")
    frames = newest and (newest.tree["frames"], *newest.tree["x"].unique().tolist())
    return {"frames": frames, "rows": rows_in(folder)}


def rows_in(folder: Path) -> bytes | None:
    return (folder / ROWS).read_bytes() if (folder / ROWS).exists() else None


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


class Trials:
    """All crashes of one change.

    Attributes:
        count: of each way to crash.
    """

    def __init__(self, change: Change, place: Path) -> None:
        self.change, self.place = change, place / change.__name__
        self.count: Counter[str] = Counter()
        self.made = 0
        folder = self._folder()
        self.old = held(folder)
        calls: list[Call] = []
        with told(calls.append):
            change(folder)
        self.calls, self.new, self.names = calls, held(folder), names(folder)

    def run(self, every: int) -> None:
        """Cut the power at each call, and kill and interrupt at one in `every`. Raises Broken."""
        self._cut_power()
        for number in range(0, len(self.calls), every):
            self._kill(number)
            self._interrupt(number)

    def _folder(self) -> Path:
        self.made += 1
        folder = self.place / str(self.made) / "run"
        folder.parent.mkdir(parents=True)
        before(folder, self.change)
        return folder

    def _kill(self, number: int) -> None:
        folder = self._folder()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads that pytest may have
            pid = os.fork()
        if not pid:
            try:
                self._until(number, folder, lambda: os.kill(os.getpid(), signal.SIGKILL))
            finally:
                os._exit(1)
        _, status = os.waitpid(pid, 0)
        assert os.waitstatus_to_exitcode(status) == -signal.SIGKILL
        self._check(folder, "SIGKILL", number)

    def _interrupt(self, number: int) -> None:
        def crash() -> None:
            raise Crash

        folder = self._folder()
        try:
            self._until(number, folder, crash)
        except Crash:
            self._check(folder, "KeyboardInterrupt", number)
            return
        raise Broken(f"{self.change.__name__}: a KeyboardInterrupt is lost at call {number}")

    def _until(self, number: int, folder: Path, crash: Callable[[], None]) -> None:
        """Make the change until a call, and there `crash`."""
        made = 0

        def tell(call: Call) -> None:
            nonlocal made
            made += 1
            if made == number + 1:
                crash()

        with told(tell):
            self.change(folder)

    def _cut_power(self) -> None:
        """Make the change once, and look at what the disk may hold at every call."""
        folder = self._folder()
        disk, draw, made = Disk(folder.parent), random.Random(0), 0
        cuts: list[tuple[int, Left]] = []

        def tell(call: Call) -> None:
            nonlocal made
            disk.note(call)
            for share in KEPT:
                left = disk.left(lambda share=share: draw.random() < share)
                if all(left != other for _, other in cuts):
                    cuts.append((made, left))
            made += 1

        with told(tell):
            self.change(folder)
        for number, left in cuts:
            image = self.place / f"cut-{self.count[POWER_CUT]}"
            write(left, image)
            self._check(image / "run", POWER_CUT, number)

    def _check(self, folder: Path, way: str, number: int) -> None:
        call = self.calls[number]
        where = f"{self.change.__name__}: {way} {'after' if call.done else 'before'} {call.name}"
        where += f" of {Path(call.path).name} (call {number})"
        self.count[way] += 1
        try:
            now = held(folder)
            if now not in (self.old, self.new):
                raise Broken(f"{now} is neither {self.old} nor {self.new}")
            self.change(folder)
        except (Broken, ValueError, OSError) as error:
            raise Broken(f"{where}: {error}") from error
        if names(folder) != self.names:
            left = sorted({*names(folder)} ^ {*self.names})
            raise Broken(f"{where}: once more leaves other files: {left}")
        shutil.rmtree(folder.parent)


def crash(changes: Sequence[Change] = CHANGES, every: int = 1) -> Counter[str]:
    """Crash every change in every way at the calls; return how often. Raises Broken."""
    count: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        for change in changes:
            trials = Trials(change, Path(place))
            trials.run(every)
            count += trials.count
    return count


def main() -> None:
    began = time.monotonic()
    count = crash()
    listed = ", ".join(f"{number} by {way}" for way, number in count.items())
    sys.stdout.write(
        f"{count.total()} crashes ({listed}): 0 recover neither the old nor the new state;"
        f" {time.monotonic() - began:.0f} s\n"
    )


if __name__ == "__main__":
    main()
