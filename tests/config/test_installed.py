"""A library is there when it is installed, not when a folder has its name."""

from pathlib import Path

import pytest

from marl_clean.config.installed import is_installed


def test_a_folder_of_the_name_is_no_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "not_a_library").mkdir()
    (tmp_path / "not_one_either").mkdir()
    (tmp_path / "not_one_either" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert not is_installed("not_a_library")
    assert not is_installed("not_one_either")


def test_what_is_installed_is_there_under_the_name_of_its_module() -> None:
    assert is_installed("torch")
    assert is_installed("hydra-core", "hydra")
    assert not is_installed("hydra-core", "no_such_module")
