"""The example scripts run: learners of other libraries on the cleaning world.

Development tests: neither library is one of the test extra's. BenchMARL 1.5.2 asks for torchrl
below 0.12 and is installed with --no-deps; see the scripts for the versions tried.
"""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "argument", "needs", "says"),
    [
        (
            "benchmarl_task.py",
            "2",
            ("benchmarl", "tqdm"),
            [f"{name}: 640 frames" for name in ("IppoConfig", "IqlConfig", "QmixConfig")],
        ),
        ("sb3_ppo.py", "1024", ("stable_baselines3", "supersuit"), ["% clean at the end"]),
    ],
)
def test_learners_of_others_train(
    script: str, argument: str, needs: tuple[str, ...], says: list[str], tmp_path: Path
) -> None:
    if missing := [name for name in needs if find_spec(name) is None]:
        pytest.skip(f"needs {', '.join(missing)}; see examples/{script}")
    command = [sys.executable, str(EXAMPLES / script), argument]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    assert all(line in done.stdout for line in says)
