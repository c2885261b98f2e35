"""Wrong settings: `python -m tests.reliability.settings --trials 2000`.

Every key of every level, of the config's root and of the commands' own settings is given values
that it cannot have, a section or a level that does not exist, or is misspelt, under commands by
turns; the wrong commands written by hand (`tests.commands.bad_commands`) come first. All run in
one process in which torch cannot be imported. Each must end with exit code 2 and one line that
names the key and what is valid, within 3 s of CPU time, and leave nothing behind.
"""

import argparse
import os
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from marl_clean.config.levels import SEVERAL, conf_folder, read_level, rooms
from marl_clean.storage.safe_yaml import load_yaml
from tests.commands.bad_commands import BAD_COMMANDS, MORE_BAD_COMMANDS, complaint, write_plans

MOST_SECONDS = 3.0
COMMANDS = (
    "train",
    "train -m",
    "evaluate",
    "watch",
    "figure paper_1",
    "benchmark",
    "tune seed=1,2",
)
FEWER = {"logger": COMMANDS[:2]}  # rooms that other commands do not use
OF_ANY = ("{a:{b:1}}", "[[[x]]]")
OF_KIND: dict[type, tuple[str, ...]] = {
    bool: ("maybe", "2", "[true]", *OF_ANY),
    int: ("abc", "1.5", "-7", "99999999999", "[3]", "true", "1e30", *OF_ANY),
    float: ("abc", "nan", "inf", "-inf", "1e400", "[1]", "true", *OF_ANY),
    str: ("[1]", "7", "true", *OF_ANY),
    list: ("abc", "7", "[[]]", "[abc]", "[-1]", "[nan]", "[99999999999]", *OF_ANY),
    type(None): OF_ANY,
    dict: ("5", "[1]", "{nope:1}", "null"),
}
FREE = {  # keys whose yaml does not show what they may be
    ("topology.view_size", "7"),  # taken from the observation
    ("env.options", OF_ANY[0]),
}
OWN = (
    *(f"headroom headroom.{key}" for key in ("sides=7", "robots=[1]", "reaches=[0]", "houses=0")),
    *(f"headroom headroom.{key}" for key in ("losses=[2]", "sides=[5000]", "robotss=[2]")),
    *(f"tune seed=1,2 tune.{key}" for key in ("trials=x", "trials=1.5", "measure=7", "nam=x")),
    *(f"study quick_study {key}" for key in ("trainer=nope", "agent.lr=x", "device=tpu")),
    *("train --budget=3", "matrix --houses RUN", "verify"),
    *("list levels", "doctor --fix", "runs --state=gone", "report", "compare", "study nope"),
    *("verify nowhere", "figure nope", "figure paper_1 seed"),
    *("train -m seed=1,2 hydra/launcher=joblib hydra.launcher.n_jobs=x", "train -m hydra/nope=1"),
)


class WithoutTorch(MetaPathFinder, Loader):
    """Lets the import of torch fail: a command that needs it has accepted its settings."""

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:
        return ModuleSpec(name, self, origin=name) if name == "torch" else None

    def exec_module(self, module: ModuleType) -> None:
        raise ImportError("torch was imported")


def written_by_hand() -> dict[str, str]:
    """Commands and what the line about each names."""
    own = {command: command.split()[-1].partition("=")[0].lstrip("-") for command in OWN}
    return {**BAD_COMMANDS, **MORE_BAD_COMMANDS, **own}


def generated() -> Iterator[tuple[str, str]]:
    """Every wrong command that the yaml files give rise to, and the key that it is wrong by."""
    root = load_yaml(conf_folder() / "config.yaml")
    places: list[tuple[str, str, Mapping[str, Any]]] = [("", "", root)]
    for room, levels in rooms().items():
        for level in levels:
            several = room in SEVERAL
            choice = f"{room}=[{level}]" if several else f"{room}={level}"
            key = f"{room}.{level}." if several else f"{room}."
            places.append((choice, key, read_level(room, level)))
        yield from ((f"{command} {room}=nope", room) for command in COMMANDS)
    for choice, prefix, section in places:
        commands = FEWER.get(prefix.partition(".")[0], COMMANDS)
        for number, (key, value) in enumerate(_settings(section, prefix)):
            command = commands[number % len(commands)]
            yield " ".join(filter(None, [command, choice, f"{key}={value}"])), key


def _settings(section: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, str]]:
    """Every key of a section, misspelt once, and the values that it cannot have."""
    for name, default in section.items():
        if name in ("_target_", "defaults"):
            continue
        key = f"{prefix}{name}"
        yield f"{key}{name[-1]}", "1"
        for value in OF_KIND[type(default)]:
            if (key, value) not in FREE:
                yield key, value
        if isinstance(default, Mapping):
            yield from _settings(default, f"{key}.")


def fault(command: str, named: str) -> str:
    """What is wrong with how a command is refused; empty if nothing is."""
    began = time.process_time()
    try:
        wrong = complaint(command, named)
    except (Exception, SystemExit) as error:
        return f"{command[:100]}: not refused, or with a traceback: {error!r}"
    seconds = time.process_time() - began
    if not wrong and seconds >= MOST_SECONDS:
        return f"{command[:100]}: refused after {seconds:.1f} s"
    return wrong


def check(trials: int, more: Mapping[str, str], seed: int = 0) -> str:
    """Try `more` commands and some that are generated, in a folder of their own.

    Return a line of what was seen.

    Raises AssertionError with every command that is not refused as it should be.
    """
    commands = sorted(set(generated()))
    random.Random(seed).shuffle(commands)
    commands = [*more.items(), *commands[:trials]]
    began, longest, before = time.process_time(), 0.0, Path.cwd()
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        write_plans()
        try:
            for command, named in commands:
                start = time.process_time()
                faults += filter(None, [fault(command, named)])
                longest = max(longest, time.process_time() - start)
        finally:
            os.chdir(before)
    assert not faults, f"{len(faults)} of {len(commands)}:\n" + "\n".join(faults)
    return (
        f"{len(commands)} wrong commands: 0 accepted, 0 tracebacks, 0 of more than one line,"
        f" 0 files left; {time.process_time() - began:.1f} s, the longest {longest:.2f} s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=250, help="of the generated commands")
    parser.add_argument("--by-hand", action="store_true", help="and all that are written by hand")
    arguments = parser.parse_args()
    sys.meta_path.insert(0, WithoutTorch())
    more = written_by_hand() if arguments.by_hand else {}
    sys.stdout.write(check(arguments.trials, more) + "\n")


if __name__ == "__main__":
    main()
