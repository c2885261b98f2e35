"""A run's lock, kept by the operating system: a process that dies takes its lock with it.

The lock is one of `flock` on the file `.lock` in the run's folder; what the file says about its
holder is for people. A file that a killed process leaves behind holds nothing.
"""

import errno
import fcntl
import json
import logging
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from marl_clean.errors import BadInput

LOCK = ".lock"
TRIES, PAUSE_SECONDS = 10, 0.02  # a reader of the lock holds it for microseconds
WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)  # of some network filesystems
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Holder:
    """The process that holds a lock: its id, its machine, and the local time it took the lock."""

    pid: int
    host: str
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host} since {self.since}"


class Held(BadInput):
    """Another process works in the folder."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of `folder`, which is made if need be, and removed if it then stays empty.

    Raises:
        Held: another process has it; the message names the process.
        BadInput: the folder cannot be made or written.
    """
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        descriptor = _acquire(folder)
    except OSError as error:
        raise BadInput(f"{folder} cannot be written: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):
            (folder / LOCK).unlink()  # before others can take it
        os.close(descriptor)
        for place in made:
            with suppress(OSError):
                place.rmdir()  # which only an empty one is


def holder(folder: Path) -> Holder | None:
    """The process that works in `folder`; None if there is none."""
    try:
        descriptor = os.open(folder / LOCK, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _read(descriptor)
    except OSError:  # a filesystem without locks
        return None
    finally:
        os.close(descriptor)
    return None


def check_free(folder: Path) -> None:
    """Raises Held where another process works in `folder`."""
    if (other := holder(folder)) is not None:
        raise Held(f"{folder}: held by {other}; wait until it ends, or stop it")


def _acquire(folder: Path) -> int:
    """The descriptor of the lock file of `folder`, locked. Raises Held or OSError."""
    for attempt in range(TRIES):
        if attempt:
            time.sleep(PAUSE_SECONDS)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except FileNotFoundError:  # another process has just removed the folder
            continue
        try:
            if _lock(descriptor) and _is_at(descriptor, folder / LOCK):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, json.dumps(asdict(_this_process())).encode())
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    check_free(folder)
    raise Held(f"{folder}: held by a process that ends just now; the same command again")


def _lock(descriptor: int) -> bool:
    """Whether the lock could be taken, or there are none on this filesystem."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in WITHOUT_LOCKS:
            raise
        log.warning("no locks on this filesystem: see that no run is started twice at once")
    return True


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether the open file is the one at `path`, not one that its last holder has removed."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _this_process() -> Holder:
    return Holder(os.getpid(), socket.gethostname(), datetime.now().isoformat(" ", "seconds"))


def _read(descriptor: int) -> Holder:
    """What the file says of its holder, which may be about to write it."""
    try:
        fields = json.loads(os.pread(descriptor, 4096, 0))
        return Holder(int(fields["pid"]), str(fields["host"])[:100], str(fields["since"])[:30])
    except (ValueError, TypeError, KeyError, RecursionError):
        return Holder(0, "an unknown machine", "just now")
