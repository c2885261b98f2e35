"""One job of a sweep, in whatever process its launcher chose.

All that others learn of it is in its run's folder: what it printed in `job.log`, why it failed
in `failed.txt`, its metrics and its result as those of any run.
"""

import os
import traceback
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from marl_clean.commands.checks import check_all
from marl_clean.commands.command_line import issued
from marl_clean.commands.run_info import FAILED, LOG, is_finished
from marl_clean.config.locate import use_plugins
from marl_clean.config.stored import RUNS, compose_for_training
from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage.lock import Held, check_free

MOST_DEATHS = 3  # of a job, whose process is killed each time; then it counts as failed
KILLED = f"its process was killed {MOST_DEATHS} times (out of memory?)"
LOGGED_BYTES = 64 << 10  # of the log, in the file of a failure


def train_job(settings: Sequence[str], plugins: Sequence[str] = (), driver: int = 0) -> None:
    """Train one job, or what is left of it; an error is noted in its folder and not raised.

    Its settings are composed here, since Hydra does not know a checkpoint's config, and checked
    again, since the job may run on another machine than the launcher. `driver`: the process of
    the sweep, which a signal ends; in another process it ends this job alone, with its state saved.
    """
    [*_, name] = (s.removeprefix("name=") for s in settings if s.startswith("name="))
    folder = RUNS / name
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOG).open("a", encoding="utf-8", buffering=1) as log:
        begins = log.tell()
        with redirect_stdout(log), redirect_stderr(log), issued(["train", *settings]):
            try:
                _train(settings, folder, plugins)
            except Held as error:
                log.write(f"{error}\n")
            except BadInput as error:
                log.write(f"{error}\n")
                note_failure(folder, str(error), settings, begins)
            except Exception as error:
                traceback.print_exc()
                note_failure(folder, f"{type(error).__name__}: {error}", settings, begins)
            except (SystemExit, KeyboardInterrupt) as end:
                log.write(f"stopped by a signal ({end!r}); the same command resumes it\n")
                if os.getpid() == driver:
                    raise


def _train(settings: Sequence[str], folder: Path, plugins: Sequence[str]) -> None:
    use_plugins(plugins)
    check_free(folder)
    config = compose_for_training(settings)
    check_all(config, training=True)
    if is_finished(config, folder):  # another sweep has come first
        return
    (folder / FAILED).unlink(missing_ok=True)
    from marl_clean.commands import train

    train.main(config, folder)


def note_failure(folder: Path, reason: str, settings: Sequence[str], begins: int = 0) -> None:
    """Write why a job failed: the reason in one line, its settings, and its log from `begins`."""
    line = " ".join(reason.split())
    head = f"{line}\n\nsettings: {' '.join(settings)}\n\n"
    try:
        with (folder / LOG).open("rb") as file:
            file.seek(max(begins, file.seek(0, os.SEEK_END) - LOGGED_BYTES))
            log = file.read()
    except OSError:
        log = b""
    files.write_file(folder / FAILED, [head.encode(errors="replace"), log])
