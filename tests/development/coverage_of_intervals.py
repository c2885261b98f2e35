"""How often a 95 % interval of the IQM holds what it estimates, by the way of resampling.

    python tests/development/coverage_of_intervals.py

Worlds are drawn in which the truth is known: value[r, h] = run[r] + house[h] + noise, normal with
standard deviations 8, 20 and 39 steps, as runs of this project differ in T_100. Prints the share of
trials whose interval holds 0, the mean over all runs and houses, and its mean width.
"""

import numpy as np

from marl_clean.evaluation.aggregates import iqm
from marl_clean.evaluation.resampling import Resampling, interval

TRIALS = 1_000
HOUSES = 100
DRAWS = 500


def main() -> None:
    """Print a line for each number of runs and each way of resampling."""
    for runs in (1, 3, 5, 10):
        rng = np.random.default_rng(runs)
        samples = [
            rng.normal(0, 8, (runs, 1))
            + rng.normal(0, 20, (1, HOUSES))
            + rng.normal(0, 39, (runs, HOUSES))
            for _ in range(TRIALS)
        ]
        for how in Resampling:
            ends = np.array([interval(sample, iqm, how, DRAWS).ci95 for sample in samples])
            held = ((ends[:, 0] <= 0) & (ends[:, 1] >= 0)).mean()
            width = (ends[:, 1] - ends[:, 0]).mean()
            print(f"{runs:2} runs, {how.value:16} holds {100 * held:.0f} %, width {width:.1f}")


if __name__ == "__main__":
    main()
