"""The scenarios that ship: every arm of their studies fits, trains, and is what its name says."""

from functools import cache
from pathlib import Path

import pytest
from omegaconf import DictConfig

from marl_clean import cli
from marl_clean.commands import train
from marl_clean.config.compose import compose_config
from marl_clean.config.fitting import check_fit
from marl_clean.config.levels import conf_folder
from marl_clean.config.presets import study_of
from tests.families import family

STUDIES = {
    path.stem: study
    for path in sorted((conf_folder() / "experiment").glob("*.yaml"))
    if (study := study_of(path)) is not None
}
SCENARIOS = ["guide", "right_of_way", "spill_alarm", "who_cleaned_what"]


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_study_is_of_its_scenario(name: str) -> None:
    study, plain = (
        compose_config([f"experiment={preset}", "name=same"]) for preset in (f"{name}_study", name)
    )
    assert study == plain


@cache
def composed(name: str, arm: str) -> DictConfig:
    """The config of a study's arm."""
    return compose_config([f"experiment={name}", *STUDIES[name]["arms"][arm]])


@pytest.mark.slow
@family("name", STUDIES, fast=[], usual=2)
def test_every_arm_of_a_study_fits_and_rules_name_arms(name: str) -> None:
    study = STUDIES[name]
    for arm in study["arms"]:
        check_fit(composed(name, arm))
    for rule in study["rules"].values():
        assert rule["arm"] in study["arms"] and rule.get("than", "random") in (
            *study["arms"],
            "random",
        )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_controls_and_oracles_differ_from_the_others_in_nothing_else(name: str) -> None:
    study = STUDIES[f"{name}_study"]

    def section(arm: str, *rooms: str) -> dict:
        return {room: composed(f"{name}_study", arm)[room] for room in rooms}

    rest = ("house", "env", "observation", "topology", "reward", "encoder", "agent", "trainer")
    for control in ("zeroed", "self_send"):
        assert section(control, "comm", *rest) == section("commnet", "comm", *rest)
    for arm in set(study["arms"]) - {"oracle"}:
        assert section(arm, *rest) == section("silent", *rest)
    oracle, silent = section("oracle", "comm", "env"), section("silent", "comm", "env")
    assert oracle["comm"] == silent["comm"] and oracle["env"] != silent["env"]


@pytest.mark.long
@pytest.mark.parametrize("name", ["right_of_way", "spill_alarm"])  # the others differ in less
def test_a_scenario_trains(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "draw", lambda config, folder: None)
    tiny = ["budget=smoke", "train_houses=16", "env.num_envs=16", "env.max_steps=10"]
    tiny += ["trainer.total_frames=256", "trainer.frames_per_batch=128", "evaluation.houses=2"]
    tiny += ["trainer.minibatch_frames=64", "trainer.log_interval_frames=128"]
    arm = STUDIES[f"{name}_study"]["arms"]["commnet"]
    assert cli.main(["train", f"+experiment={name}", *arm, *tiny]) == 0
