"""What `doctor` looks at beside packages: disk, clock, locale, GPU, browser, launchers."""

import locale
import shutil
import tempfile
import time
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from marl_clean.config.hydra_launching import LAUNCHERS, launchers
from marl_clean.config.installed import is_installed
from marl_clean.storage import files

LEAST_FREE = 2 << 30  # bytes: two states of a run with the default buffer
WRITES, SLOW_SECONDS = 5, 0.5  # each of a save's dozen flushes is waited for
CLOCK_SECONDS = 2.0  # that a file's time may be off
AHEAD_SECONDS = 60.0  # that an earlier file may be newer than now
DRIVERS = ("/proc/driver/nvidia/version", "/dev/nvidia0", "/dev/dxg")
OF_LAUNCHER = {"joblib": "hydra-joblib-launcher", "submitit_local": "hydra-submitit-launcher"}


@dataclass(frozen=True)
class Finding:
    """One line of the report; `remedy` is empty where nothing is wrong."""

    name: str
    state: str
    remedy: str = ""


def machine_findings() -> Iterator[Finding]:
    """The state of this machine and of the folder that runs are written to."""
    yield disk()
    yield from writing()
    yield encoding()
    yield browser()
    yield launching()


def disk() -> Finding:
    """The space for runs, here."""
    free = shutil.disk_usage(Path.cwd()).free
    remedy = f"free {LEAST_FREE >> 30} GiB, or start elsewhere: states need it"
    return Finding("disk", f"{free / (1 << 30):.1f} GiB free", remedy if free < LEAST_FREE else "")


def writing() -> Iterator[Finding]:
    """How long a flushed write takes here, and whether times of files are those of the clock."""
    seconds = []
    try:
        with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix=files.HIDDEN) as folder:
            for number in range(WRITES):
                began = time.perf_counter()
                files.write_file(path := Path(folder, str(number)), [b"doctor"])
                seconds.append(time.perf_counter() - began)
            off = path.stat().st_mtime - time.time()
    except OSError as error:
        yield Finding("writing", f"refused: {error.strerror}", "start in a folder of your own")
        return
    usual = sorted(seconds)[WRITES // 2]
    slow = "start on a local disk: every save waits for a dozen of these"
    state = f"{1000 * usual:.0f} ms a flushed file"
    yield Finding("writing", state, slow if usual > SLOW_SECONDS else "")
    yield clock(off)


def clock(off: float) -> Finding:
    """Whether the clock agrees with new files, which are `off` seconds ahead, and with old ones."""
    mend = "set the clocks of this machine and of its file server, as by NTP"
    if abs(off) > CLOCK_SECONDS:
        return Finding("clock", f"{abs(off):.0f} s off the times of new files", mend)
    for path in (Path(__file__), *sorted(Path.cwd().glob("runs/*"))):
        ahead = path.stat().st_mtime - time.time()
        if ahead > AHEAD_SECONDS:
            return Finding("clock", f"went back: {path} was written {ahead:.0f} s from now", mend)
    return Finding("clock", "as the times of files")


def encoding() -> Finding:
    """Whether texts are UTF-8 by default: names of houses and tables hold more than ASCII."""
    name = locale.getpreferredencoding(False)
    is_utf8 = name.lower().replace("-", "") == "utf8"
    return Finding("locale", name, "" if is_utf8 else "export PYTHONUTF8=1, or LANG=C.UTF-8")


def browser() -> Finding:
    """What opens report.html here."""
    try:
        return Finding("browser", getattr(webbrowser.get(), "name", "the system's"))
    except webbrowser.Error:
        return Finding("browser", "none: copy report.html, one file, to where there is one")


def launching() -> Finding:
    """The launchers of sweeps, and those whose package is there and does not work."""
    there = launchers()
    for level, distribution in OF_LAUNCHER.items():
        if level not in there and is_installed(distribution, "hydra_plugins"):
            broken = f"{distribution} is installed, {level} is missing"
            return Finding("launchers", broken, f"pip install --force-reinstall {distribution}")
    missing = [f"{level}: pip install {LAUNCHERS[level]}" for level in LAUNCHERS]
    missing = [text for text in missing if text.partition(":")[0] not in there]
    more = f" (not installed: {'; '.join(missing)})" if missing else ""
    return Finding("launchers", f"{', '.join(there)}{more}")


def gpu(devices: int) -> Finding | None:
    """What is wrong where there is a GPU and torch has `devices`; None where nothing is."""
    driver = next((path for path in DRIVERS if Path(path).exists()), None)
    if devices or driver is None:
        return None
    remedy = "install torch for CUDA (pytorch.org/get-started), or train on the CPU"
    return Finding("gpu", f"there is one ({driver}), and torch does not see it", remedy)
