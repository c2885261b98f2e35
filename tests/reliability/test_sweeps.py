"""A small sweep under fire, launcher by launcher; `tests.reliability.sweeps` runs large ones."""

import pytest

from tests.reliability.sweeps import check

PLUGINS = {"basic": "hydra", "joblib": "hydra_plugins.hydra_joblib_launcher"}


@pytest.mark.long
@pytest.mark.parametrize("launcher", PLUGINS)
def test_a_sweep_whose_workers_and_driver_are_killed_is_completed(launcher):
    pytest.importorskip(PLUGINS[launcher], reason="extra `sweep` is not installed")
    line = check(launcher, jobs=4, seconds=0.3, kills=1)
    assert line.startswith(f"{launcher}: 4 of 4 finished, none twice, same table; 1 workers killed")
