"""Signals at any moment: `python -m tests.reliability.signals --trials 200 --starts 40`.

A fork of this warm process trains as a command does, on and off policy by turns, and gets SIGTERM
or SIGINT at a random moment from its first on; often each update is made slow, so that learning
from one block takes longer than it may take to end. It must end with 143 or 130 within 5 s, and
the same training again must end with the weights and rows of the one that was left alone. Whole
processes of `train` get their signal while Python, the settings and torch are loaded: they must end
so without a traceback.
"""

import argparse
import faulthandler
import logging
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import torch

from marl_clean import cli
from marl_clean.commands._signals import ENDING, begin, end_at_once_by_signals
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer.off_policy import OffPolicyLoop
from marl_clean.trainer.on_policy import OnPolicyLoop
from tests.trainer.test_off_policy import assert_same_results
from tests.trainer.test_resume import KINDS, train

KINDS_TRIED = ("on policy", "mixed", "with memory", "pqn")
MOST_SECONDS = 5.0  # from a signal to the end
SLOW_SECONDS = 2.6  # of an update that is made slow; a block has two or more
ROOT = Path(__file__).parents[2]


class Broken(AssertionError):
    """A promise that did not hold."""


@contextmanager
def slow_updates(seconds: float, begun: Path) -> Iterator[None]:
    """Within this context each update takes so long, and the first makes the file `begun`."""

    def slowed(update: Callable) -> Callable:
        def run(*arguments: object) -> object:
            begun.touch()
            time.sleep(seconds)
            return update(*arguments)

        return run

    with (
        mock.patch.object(OnPolicyLoop, "update", slowed(OnPolicyLoop.update)),
        mock.patch.object(OffPolicyLoop, "update", slowed(OffPolicyLoop.update)),
    ):
        yield


def in_a_fork(run: Callable[[], None], errors: Path) -> int:
    """Carry out `run` as a command in a fork of this process; return the process.

    Signals that are sent to it wait until its handlers are there: they come from its beginning on.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads that pytest may have
            process = os.fork()
        if process:
            return process
    finally:
        if process:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
    code = 1
    try:
        os.dup2(os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
        faulthandler.register(signal.SIGUSR1)
        end_at_once_by_signals()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)

        def command(arguments: object) -> int:
            begin("train")
            run()
            return 0

        with mock.patch.dict(cli.COMMANDS, list=command):
            code = cli.main(["list"])
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        os._exit(code)


def ended(process: int, within: float) -> tuple[int, float]:
    """Wait for a process; return its exit code and the seconds. Raises Broken after `within`."""
    began = time.monotonic()
    while time.monotonic() - began < within:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), time.monotonic() - began
        time.sleep(0.01)
    cpu = sum(map(int, Path(f"/proc/{process}/stat").read_text().split()[13:15]))
    if _catches(process, signal.SIGUSR1):  # a fork writes where it is
        os.kill(process, signal.SIGUSR1)
        time.sleep(0.5)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    raise Broken(f"has not ended {within} s after its signal; {cpu} ticks of CPU since its start")


def interrupt(
    place: Path,
    kind: str,
    number: int,
    wait: float | None,
    slow: bool,
    within: float = MOST_SECONDS,
) -> tuple[float, bool]:
    """Signal a training after `wait` seconds, and finish it; with None it signals itself.

    `slow`: its updates, from the first of which on it waits.

    Return how long it took to end, and whether that was between two updates of a block.

    Raises Broken where a promise does.
    """
    folder, whole = place / "torn", place / kind
    begun = place / "begun"
    with slow_updates(SLOW_SECONDS if slow else 0.0, begun):
        process = in_a_fork(lambda: train(folder, kind), place / "errors.txt")
    if wait is not None:
        while slow and not begun.exists():
            time.sleep(0.01)
        time.sleep(wait)
        os.kill(process, number)
    try:
        code, seconds = ended(process, within)
    except Broken as error:
        said = (place / "errors.txt").read_text()
        raise Broken(f"{kind}, signal {number} after {wait} s: {error}: {said[-2000:]}") from None
    said = (place / "errors.txt").read_text()
    if code not in (0, 128 + number) or "Traceback" in said:
        raise Broken(f"{kind}, signal {number} after {wait} s: exit {code}: {said[-2000:]}")
    state = Checkpoints(folder / FOLDER).newest("state")
    if code and (folder / "metrics.csv").exists() and state is None:
        raise Broken(f"{kind}, signal {number} after {wait} s: no state was saved")
    train(folder, kind)
    assert_same_results(folder, whole)
    return seconds, code != 0 and state is not None and state.tree["owed"] is not None


def check(trials: int, seed: int = 0, within: float = MOST_SECONDS) -> str:
    """Interrupt trainings, which end `within` seconds; return a line of what was seen."""
    torch.set_num_threads(1)
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports every buffer it makes
    draw, longest, in_blocks = random.Random(seed), 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        lasts = {}
        for kind in KINDS_TRIED[:trials]:
            began = time.monotonic()
            train(Path(folder) / kind, kind)
            lasts[kind] = time.monotonic() - began
        for trial in range(trials):
            kind, slow = KINDS_TRIED[trial % len(KINDS_TRIED)], trial % 3 == 1
            wait = draw.uniform(0, 3.0 if slow else lasts[kind])
            with tempfile.TemporaryDirectory(dir=folder) as place:
                os.symlink(Path(folder) / kind, Path(place) / kind)
                number = ENDING[trial // 2 % 2]
                seconds, in_block = interrupt(Path(place), kind, number, wait, slow, within)
            longest, in_blocks = max(longest, seconds), in_blocks + in_block
    return (
        f"{trials} signals to trainings, {in_blocks} between updates of a block: 0 other exit"
        f" codes, 0 states lost, 0 other results; the longest end took {longest:.2f} s"
    )


def check_starts(starts: int, seconds: float, seed: int = 0, within: float = MOST_SECONDS) -> str:
    """Signal whole processes within their first `seconds`; return a line of what was seen.

    Before the program's first line a signal is Python's own affair: it is sent again if it is lost.
    """
    draw, longest, early, other = random.Random(seed), 0.0, 0, 0
    for start in range(starts):
        wait, number = draw.uniform(0, seconds), ENDING[start % 2]
        with tempfile.TemporaryDirectory() as place, Path(place, "errors.txt").open("wb") as errors:
            process = subprocess.Popen(
                [sys.executable, "-m", "marl_clean", "train", "budget=smoke"],
                cwd=place,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdout=subprocess.DEVNULL,
                stderr=errors,
            )
            time.sleep(wait)
            is_ours = _catches(process.pid, signal.SIGTERM)
            process.send_signal(number)
            try:
                code, took = ended(process.pid, within)
            except Broken:
                if is_ours:
                    raise
                code, took = 1, 0.0
            process.returncode = code  # it is waited for already
            said = Path(place, "errors.txt").read_text()
            if is_ours and (code != 128 + number or "Traceback" in said):
                raise Broken(f"signal {number} after {wait:.3f} s: exit {code}: {said[-2000:]}")
            longest = max(longest, took)
            early += not is_ours
            other += not is_ours and code not in (128 + number, -number)
    return (
        f"{starts} signals in the first {seconds:g} s of processes: 0 other exit codes from the"
        f" program's first line on, the longest end took {longest:.2f} s; of {early} before that"
        f" line Python made another end of {other}"
    )


def _catches(process: int, number: int) -> bool:
    """Whether a process has a handler for a signal, as Linux says."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    [caught] = [line.split()[1] for line in lines if line.startswith("SigCgt:")]
    return bool(int(caught, 16) >> (number - 1) & 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--starts", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=6.0, help="in which starts get a signal")
    arguments = parser.parse_args()
    assert set(KINDS_TRIED) <= KINDS.keys()
    sys.stdout.write(check(arguments.trials) + "\n")
    sys.stdout.write(check_starts(arguments.starts, arguments.seconds) + "\n")


if __name__ == "__main__":
    main()
