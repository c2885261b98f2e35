"""Every test runs with the shapes and types in the annotations checked at run time."""

import gc
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxtyping import config

from tests import checks

gc.disable()  # all that is imported stays: to look for garbage in it takes a quarter of the imports
checks.install()

import pytest  # noqa: E402  (nothing may import the package before the hook)
import torch  # noqa: E402


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Look for garbage in what tests make alone, not in the modules and tests, again and again."""
    gc.freeze()
    gc.enable()


def pytest_runtest_setup() -> None:
    checks.calls.clear()


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Let a run be repeated to the last bit, and two tests at once not wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def unchecked() -> Iterator[None]:
    """Leave out the checks of shapes and types, which take half of the time of a training run.

    For tests that train for thousands of frames to see what is learnt, or play for thousands to
    see that a play repeats: every function that they call is checked in other tests.
    """
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)


@pytest.fixture
def run_script(tmp_path: Path) -> Callable[[str], None]:
    """Run a module of its own process, without the checks at run time; it must end well.

    By a link, since torch cannot compile from a path with a space (see `check_compile`).
    """

    def run(module: str) -> None:
        environment = tmp_path / "environment"
        environment.symlink_to(sys.prefix)
        python = environment / Path(sys.executable).relative_to(sys.prefix)
        # Tracing makes objects by the million, all of them in use: no search for garbage in them.
        code = f"import gc, runpy; gc.disable(); runpy.run_module({module!r}, run_name='__main__')"
        command = [str(python), "-W", "ignore", "-c", code]
        root = Path(__file__).parents[1]
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=1200)
        assert done.returncode == 0, done.stderr

    return run
