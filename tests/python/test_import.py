"""The package's door opens quickly, and every name is behind it."""

import subprocess
import sys
from importlib.resources import files

import pytest

import marl_clean


@pytest.mark.long
def test_importing_it_imports_no_torch_and_using_it_does() -> None:
    script = (
        "import sys, marl_clean\n"
        "assert not {'torch', 'torchrl', 'hydra', 'omegaconf'} & set(sys.modules)\n"
        "assert set(marl_clean.__all__) <= set(dir(marl_clean))\n"
        "import marl_clean.commands.train\n"
        "assert callable(marl_clean.train) and 'torch' in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_name_of_the_door_is_there_and_documented() -> None:
    for name in marl_clean.__all__:
        assert getattr(marl_clean, name) is not None
        assert name.startswith("__") or getattr(marl_clean, name).__doc__
    assert callable(marl_clean.train) and marl_clean.train.__name__ == "train"


def test_the_package_is_marked_as_typed() -> None:
    assert files(marl_clean).joinpath("py.typed").is_file()
