"""The energy that the machine's processors use, where Linux tells it (RAPL, in `powercap`).

Counters are the packages' (a socket with its cores), so that other processes count too; memory,
disks and GPUs do not. A counter starts anew at its range, after minutes at full power: it is read
often enough that no round is missed.
"""

import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

POWERCAP = Path("/sys/class/powercap")
READ_EVERY_SECONDS = 20.0  # a range of 65 kJ, the least known, lasts 3 minutes at 360 W


@dataclass
class Package:
    """One package's counter: where it is, its range, its last value and the energy since."""

    counter: Path
    range_microjoules: int
    last: int
    used: int = 0

    def read(self) -> None:
        """Add the energy since the last time, at most one round of the counter."""
        value = int(self.counter.read_text())
        self.used += (value - self.last) % (self.range_microjoules + 1)
        self.last = value


class CpuEnergy:
    """Counts from when it is made until `close`.

    Args:
        powercap: the folder of the kernel's zones.
    """

    def __init__(self, powercap: Path = POWERCAP) -> None:
        self.packages = _packages(powercap)
        self.failed = False
        self.closing = threading.Event()
        self.thread = threading.Thread(target=self._read_on, name="energy", daemon=True)
        if self.packages:
            self.thread.start()

    def close(self) -> float | None:
        """Return the joules of all packages; None where the system tells none, or no longer."""
        self.closing.set()
        if not self.packages:
            return None
        self.thread.join()
        self.read()
        return None if self.failed else sum(package.used for package in self.packages) / 1e6

    def read(self) -> None:
        """Read every counter once."""
        try:
            for package in self.packages:
                package.read()
        except (OSError, ValueError):
            self.failed = True

    def _read_on(self) -> None:
        while not self.closing.wait(READ_EVERY_SECONDS):
            self.read()


def _packages(powercap: Path) -> list[Package]:
    """The packages whose counters may be read; none where one of them may not.

    Zones of a package's parts (`intel-rapl:0:0`) and of the whole platform (`psys`) would count
    the same energy twice. Processors of AMD have the same zones.
    """
    packages = []
    with suppress(OSError, ValueError):
        for zone in sorted(powercap.glob("intel-rapl:*")):
            is_part = zone.name.count(":") > 1
            if is_part or not (zone / "name").read_text().startswith("package"):
                continue
            counter, largest = zone / "energy_uj", zone / "max_energy_range_uj"
            packages.append(Package(counter, int(largest.read_text()), int(counter.read_text())))
        return packages
    return []
