"""The same command begun twice at once; `tests.reliability.at_once` does it more often."""

from pathlib import Path

import pytest

from tests.reliability.at_once import WITHOUT_LOCKS, Broken, check, check_run

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_run_or_a_sweep_begun_twice_is_trained_once() -> None:
    assert check(1).endswith("0 trained twice, 0 left out, 0 drivers failed")


@pytest.mark.long
def test_a_lock_that_holds_nobody_off_is_caught(tmp_path: Path) -> None:
    with pytest.raises(Broken):
        check_run(tmp_path, 0.0, WITHOUT_LOCKS)
