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

from marl_clean.house import base as house_base  # noqa: E402

UNCOLLECTED = 500_000  # objects made and not freed since garbage was last looked for


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop() -> None:
    """Look for garbage in what tests make alone, not in the modules and tests, again and again."""
    gc.freeze()


def pytest_runtest_setup() -> None:
    checks.calls.clear()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Look for garbage between tests: within them it took a tenth of what a contract takes."""
    if gc.get_count()[0] > UNCOLLECTED:
        gc.collect()
        gc.freeze()  # what is cached now stays


_layouts: dict[tuple[str, int, int], house_base.HouseLayout] = {}


@pytest.fixture(scope="module", autouse=True)
def drawn_once() -> Iterator[None]:
    """Draw each house once: an env by the defaults draws 4,096 of them, the same in every test.

    Overridden in `tests/house`, where they are drawn anew.
    """
    draw = house_base._drawn

    def remembered(house: house_base.House, seed: int, n_agents: int) -> house_base.HouseLayout:
        if not type(house).__module__.startswith("marl_clean.house."):
            return draw(house, seed, n_agents)
        key = repr(house), seed, n_agents
        if key not in _layouts:
            _layouts[key] = draw(house, seed, n_agents)
        return _layouts[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(house_base, "_drawn", remembered)
        yield


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
