"""Trained runs that ship are known by name, wherever one stands."""

from pathlib import Path

import pytest

from marl_clean.commands.listing import lines
from marl_clean.config.compose import checked
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import find_run, load_config, shipped_runs
from marl_clean.errors import BadInput
from marl_clean.storage.manifest import weights_sha256

HASHES = {
    "any_house": "fde2be357b6d917562baaea51835992a8cfb2f2d113f15c449dac7cce19843c0",
    "approach_2_frontier": "0513bbccaf27501a7d877b4edbf81b4f8b0260a64e6ba10b30800f70342b17b3",
    "longer_horizon": "6f2e8129376a9e507e204acfa0479b37d7d09e6d760471d1473855200f93bf78",
}


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_shipped_run_is_found_by_name() -> None:
    assert set(shipped_runs()) == set(HASHES)
    assert {name: find_run(name) for name in HASHES} == shipped_runs()


@pytest.mark.parametrize("name", HASHES)
def test_what_ships_is_the_run_it_was(name: str) -> None:
    assert config_hash(checked(load_config(find_run(name)))) == HASHES[name]


def test_where_training_started_from_ships_too() -> None:
    config = load_config(find_run("longer_horizon"))
    assert weights_sha256(find_run(config["checkpoint"])) == config["weights"]


def test_a_run_of_ones_own_comes_first(elsewhere: Path) -> None:
    own = elsewhere / "runs" / "longer_horizon"
    own.mkdir(parents=True)
    (own / "config.yaml").touch()
    assert find_run("longer_horizon") == Path("runs/longer_horizon")


def test_a_misspelt_run_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(BadInput, match="did you mean approach_2_frontier"):
        find_run("docs/approach_2_frontier")


def test_they_are_listed_last() -> None:
    assert lines()[-4:] == ["checkpoint=", *(f"  {name}" for name in sorted(HASHES))]
