"""Training with processes that collect, against the single loop.

`python -m tests.benchmark.collectors`.

Each preset is trained three times side by side, in turns by slices: by the trainer alone, and with
one and two processes (`trainer.collectors`). Settings given on the command line are added to all.
Whatever else runs on the machine takes its share of the cores, so the load is printed beside.
"""

import os
import statistics
import sys
import tempfile
from pathlib import Path

import torch

from marl_clean.commands._benchmark_training import Session

PRESETS = {
    "any_house": ["+experiment=any_house", "trainer.imitate=null"],
    "paper_proximity": ["+experiment=paper_proximity", "trainer.start_frames=0"],
}
BACKENDS = {
    "trainer alone": ("none", 1),
    "1 process": ("process", 1),
    "2 processes": ("process", 2),
}
SLICES, SECONDS = 6, 3.0


def measure(settings: list[str], folder: Path) -> dict[str, list[float]]:
    """The frames a second of each way to collect, one a slice."""
    sessions = {}
    for what, (backend, num) in BACKENDS.items():
        chosen = [f"trainer.collectors.backend={backend}", f"trainer.collectors.num={num}"]
        sessions[what] = Session([*settings, *chosen], folder / what)
        sessions[what].run(SECONDS)
    rates: dict[str, list[float]] = {what: [] for what in sessions}
    for _ in range(SLICES):
        for what, session in sessions.items():
            rates[what].append(session.run(SECONDS))
    for session in sessions.values():
        session.loop.close()
    return rates


def main() -> None:
    sys.stdout.write(f"{torch.get_num_threads()} threads, {os.cpu_count()} cores\n")
    for preset, settings in PRESETS.items():
        with tempfile.TemporaryDirectory() as folder:
            rates = measure([*settings, *sys.argv[1:]], Path(folder))
        for what, slices in rates.items():
            ratios = [a / b for a, b in zip(slices, rates["trainer alone"], strict=True)]
            sys.stdout.write(
                f"{preset}, {what}: {statistics.median(slices):,.0f} frames/s,"
                f" {statistics.median(ratios):.2f} of the trainer alone"
                f" ({min(ratios):.2f} to {max(ratios):.2f}), load {os.getloadavg()[0]:.1f}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
