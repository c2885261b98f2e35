"""What docstrings show runs as it stands there, and a user's script passes mypy."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import marl_clean

pytestmark = pytest.mark.usefixtures("unchecked")

ROOT = Path(__file__).parents[2]
DOOR = ("train", "evaluate", "compare", "make_env", "load_policy", "Run", "Table", "CleaningEnv")
MODULES = ("python.door", "python.run", "python.table", "pettingzoo", "env.cleaning")
CONTRACTS = sorted(
    path.stem for path in (ROOT / "marl_clean/testing").glob("*.py") if path.stem[0] != "_"
)
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@pytest.mark.long
@pytest.mark.parametrize("name", MODULES)
def test_examples_run(name: str, run: marl_clean.Run) -> None:
    """In a folder with a finished run, runs/mine."""
    module = importlib.import_module(f"marl_clean.{name}")
    result = doctest.testmod(module, optionflags=OPTIONS)
    assert result.attempted and not result.failed


@pytest.mark.slow
@pytest.mark.parametrize("contract", CONTRACTS)
def test_examples_of_contracts_run(contract: str) -> None:
    module = importlib.import_module(f"marl_clean.testing.{contract}")
    result = doctest.testmod(module, optionflags=OPTIONS)
    assert result.attempted and not result.failed


@pytest.mark.parametrize("name", DOOR)
def test_every_name_has_an_example(name: str) -> None:
    assert ">>>" in (getattr(marl_clean, name).__doc__ or "")


@pytest.mark.parametrize("name", ["policy", "env", "evaluate", "table", "curve", "replay"])
def test_every_method_of_a_run_has_an_example(name: str) -> None:
    assert ">>>" in (getattr(marl_clean.Run, name).__doc__ or "")


# Reading these takes most of the time, and no type that the script asserts is one of theirs.
NOT_FOLLOWED = """[mypy]
[mypy-torch.*,numpy.*,scipy.*,sympy.*]
follow_imports = skip
follow_imports_for_stubs = True
"""


@pytest.mark.long
def test_a_users_script_is_typed_exactly(tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="of the extra dev")
    (tmp_path / "mypy.ini").write_text(NOT_FOLLOWED)
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports"]
    command += [
        f"--config-file={tmp_path / 'mypy.ini'}",
        f"--cache-dir={ROOT / '.mypy_cache/user'}",
    ]
    script = "tests/python/user_script.py"
    done = subprocess.run([*command, script], cwd=ROOT, capture_output=True, text=True)
    ours = [line for line in done.stdout.splitlines() if line.startswith("tests")]
    assert done.returncode in (0, 1) and not ours, done.stdout + done.stderr
