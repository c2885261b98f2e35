"""`marl-clean verify RUN`: a run's first updates made once more, and compared bit for bit."""

import reprlib
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from rich.console import Console

from marl_clean.commands.checks import check_all
from marl_clean.commands.run_record import RECORD, earlier_processes
from marl_clean.config.compose import checked
from marl_clean.config.stored import find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.table import output

DIFFERENT = 1  # exit code
LONGEST = 100  # characters of a value
MACHINE = ("cpu", "torch_threads", "device", "bfloat16", "gpu", "cuda")


def main(text: str, console: Console | None = None) -> int:
    """Repeat the first updates of a run, and say whether its weights come out; 0 if they do.

    Where they do not, what differs between the process that made them and this one is said, too.
    Raises BadInput where `text` is no run, or one of before first updates were noted, or its config
    cannot be trained here.
    """
    folder, console = find_run(text), console or output()
    from marl_clean.commands.train import train
    from marl_clean.trainer._first_updates import FILE, FirstUpdates, Repeated, read

    if not (folder / FILE).is_file():
        raise BadInput(f"verify {text}: has no {FILE}: its first updates were never noted")
    noted = read(folder / FILE)
    if not noted:
        raise BadInput(f"verify {text}: {FILE} notes no update yet")
    config = checked(load_config(folder))
    check_all(config, training=True)
    config.logger = {}
    with TemporaryDirectory() as place:
        first = FirstUpdates(Path(place), alone=True)
        try:
            train(config, Path(place), lambda: None, first_updates=first)
        except Repeated:
            pass
    for number, before in enumerate(noted):
        if [before] != first.updated[number : number + 1]:
            where = f"update {before.updates} (frame {before.frames})"
            console.print(f"{text}: weights differ after {where}", soft_wrap=True)
            for line in differences(folder, config.device):
                console.print(f"  {line}", soft_wrap=True, markup=False)
            return DIFFERENT
    what = f"weights after {noted[-1].updates} updates from {noted[-1].frames:,} frames"
    console.print(f"{text}: {what} are the same, bit for bit", soft_wrap=True)
    return 0


def _short(value: Any) -> str:
    """A value of the record, which may be anybody's, as a few printable characters."""
    text = str(value)
    return text if text.isprintable() and len(text) <= LONGEST else reprlib.repr(text)


def differences(folder: Path, device: str) -> Iterator[str]:
    """What differs between the process that began the run and this one, in a line each."""
    from marl_clean.commands import made_with

    processes = earlier_processes(folder / RECORD)
    if not processes:
        yield f"no {RECORD} says what it was made with"
        return
    began: dict[str, Any] = processes[0]
    hardware = made_with.hardware(device)
    now = {
        "versions": made_with.versions(),
        "hardware": {name: hardware[name] for name in MACHINE},
        "code": made_with.code(),
    }
    same = True
    for part, held in now.items():
        before = began.get(part)
        before = before if isinstance(before, dict) else {}  # the record may be anybody's
        for name, value in held.items():
            if before.get(name) != value:
                same = False
                yield f"{name}: {_short(before.get(name))} then, {value} now"
    if same:
        yield (
            "code, versions and hardware are the same: its config was changed since, or torch used"
            " several threads"
        )
