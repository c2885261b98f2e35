"""Every preset trains, measures and leaves what a run leaves; a preset says what Hydra reads in it.

Presets are found by their files: a new one is tested without a change here.
"""

import csv
import math
from functools import cache
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from marl_clean import build, cli
from marl_clean.commands import train
from marl_clean.config import compose
from marl_clean.config.class_source import constant
from marl_clean.config.compose import compose_config, has_houses
from marl_clean.config.levels import PRESETS, conf_folder, level_of, rooms
from marl_clean.config.presets import read_preset, study_of
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import load_config
from marl_clean.evaluation.records import MEASURES, SCHEMA, WORLD, Entry, read_entries
from marl_clean.house.base import draw_houses
from tests.families import family, world_for

pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")

EXPERIMENTS = sorted(
    path.stem
    for path in (conf_folder() / "experiment").glob("*.yaml")
    if study_of(path) is None  # trained by `study` alone: test_study.py
)
ALL = sorted(path for group in PRESETS for path in (conf_folder() / group).glob("*.yaml"))

# As small as shows that everything fits together; houses, robots and network are the preset's.
TINY = [
    "budget=smoke",
    "train_houses=16",
    "env.num_envs=16",
    "trainer.total_frames=256",
    "trainer.frames_per_batch=128",
    "trainer.log_interval_frames=128",
    "evaluation.houses=2",
    "evaluation.plans=[]",
]
SHORT = "env.max_steps=10"  # of the 16 steps that each world is trained for
DEFAULTS = compose_config()
OF_TRAINERS = {
    "off_policy": ["batch_frames=32", "replay_ratio=0.25", "start_frames=0"],
    "on_policy": ["minibatch_frames=64"],
}
ALLOWED = set(MEASURES) | {"seed", "path", "rows", "cols", "free_cells", "max_steps"}
ALLOWED |= {f"bound_{name}" for name in ("90", "95", "99", "100", "certify")}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny run of the default config, for presets that start from one."""
    place = tmp_path_factory.mktemp("before")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(train, "draw", lambda config, folder: None)
        tiny = [*TINY, *(f"trainer.{setting}" for setting in OF_TRAINERS["off_policy"])]
        assert cli.main(["train", *tiny, SHORT, "name=before"]) == 0
    return place / "runs" / "before"


@cache
def composed(preset: str) -> DictConfig:
    """The config of a preset; not to be changed."""
    return compose_config([f"experiment={preset}"])


def settings_of(preset: str, request: pytest.FixtureRequest) -> list[str]:
    config = composed(preset)
    trainer = level_of(config.trainer._target_)
    settings = [f"+experiment={preset}", *TINY]
    settings += [f"trainer.{setting}" for setting in OF_TRAINERS[trainer]]
    if config.evaluation.sides:
        settings.append("evaluation.sides=[8]")
    if has_houses(config):
        settings.append(SHORT)
    if config.checkpoint is not None:
        settings.append(f"checkpoint={request.getfixturevalue('trained')}")
    if len(sizes := config.evaluation.team_sizes) > 2:
        settings.append(f"evaluation.team_sizes=[{sizes[0]},{sizes[-1]}]")
    if "path" in config.house:
        settings.append("house.path=apartment")
    return settings


def is_measured_its_own_way(preset: str) -> bool:
    """Whether the measurement after training is not that of the default, in its own rules."""
    config = composed(preset)
    alike = config.evaluation == DEFAULTS.evaluation and config.env == DEFAULTS.env
    return not alike or config.checkpoint is not None or not has_houses(config)


def only_load(config: DictConfig, folder: Path) -> list[Entry]:
    """Stand in for the measurement after training: the best weights can be loaded."""
    assert build.load_policy(folder) is not None
    return []


@pytest.mark.slow
@family("preset", EXPERIMENTS, usual=["any_house", "paper_proximity", "quick"], fast=[])
def test_a_preset_trains_and_measures(
    preset: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    settings = settings_of(preset, request)
    monkeypatch.chdir(tmp_path)
    if preset != "quick":  # pictures take a third of the time, and are drawn the same for all
        monkeypatch.setattr(train, "draw", lambda config, folder: None)
    if not (measured := is_measured_its_own_way(preset)):
        monkeypatch.setattr(train, "measure_all", only_load)
    assert cli.main(["train", *settings]) == 0
    [folder] = Path("runs").iterdir()
    assert folder.name.startswith(f"{preset}-")
    rows = list(csv.DictReader((folder / "metrics.csv").read_text().splitlines()))
    losses = [float(row["loss"]) for row in rows if row["loss"]]
    assert losses and all(math.isfinite(loss) for loss in losses)
    assert int(rows[-1]["updates"]) >= 1 and rows[-1]["frames"] == "256"
    config = load_config(folder)
    if not measured:
        assert config["name"] == folder.name and float(rows[-1]["validation/coverage"]) > 0
        return
    entries = read_entries(folder / "evaluation.json")
    assert entries[0]["policy"] == config["name"] == folder.name
    if not has_houses(OmegaConf.create(config)):
        assert [entry["policy"] for entry in entries] == [folder.name, "random"]
        assert all(math.isfinite(entry["summary"]["return"]["mean"]) for entry in entries)
        return
    assert float(rows[-1]["validation/coverage"]) > 0
    assert {entry["policy"] for entry in entries} >= {"random", "nearest_unknown"}
    for entry in entries:
        assert (entry["schema"], entry["world"]) == (SCHEMA, WORLD)
        sizes = [config["env"]["n_agents"], *config["evaluation"]["team_sizes"]]
        assert entry["n_agents"] in sizes
        assert len(entry["houses"]) == 2
        assert all(set(house) <= ALLOWED for house in entry["houses"])
        assert set(entry["summary"]) <= set(MEASURES)
        assert 0 < entry["summary"]["coverage"]["mean"] <= 1


@family("path", ALL, fast=4, usual=12, ids=lambda path: f"{path.parent.name}={path.stem}")
def test_what_is_read_in_a_preset_is_what_hydra_composes(path: Path) -> None:
    override = [f"{path.parent.name}={path.stem}"]
    ours = compose.apply(
        OmegaConf.to_container(DEFAULTS) | {"name": None}, compose.parse_overrides(override)
    )
    theirs = OmegaConf.to_container(compose_config([*override, "name=x"]))
    assert ours | {"name": "x"} == theirs
    levels, _ = read_preset(path)
    assert set(levels) <= set(rooms())


def test_single_rooms_have_no_wall_inside() -> None:
    house = instantiate(compose_config(["experiment=single_room"]).house)
    houses = draw_houses(house, range(200), n_agents=4)
    for index in range(200):
        rows, cols = int(houses.rows[index]), int(houses.cols[index])
        inside = slice(1, rows - 1), slice(1, cols - 1)
        wall = ~houses.free[index][inside] & (houses.furniture[index][inside] == 0)
        assert not wall.any()
    assert (houses.furniture > 0).any((1, 2)).all()


def learners_and_schemes() -> list[tuple[str, str]]:
    """Every scheme once, with the learners that take it in turn; what is left of them with one."""
    schemes = sorted(path.stem for path in (conf_folder() / "comm").glob("[!_]*.yaml"))
    learners = {
        path.stem: (constant(OmegaConf.load(path)["_target_"], "fits") or {}).get("comm", schemes)
        for path in sorted((conf_folder() / "agent").glob("[!_]*.yaml"))
    }
    pairs: list[tuple[str, str]] = []
    for scheme in schemes:
        fitting = [learner for learner, takes in learners.items() if scheme in takes]
        taken = [learner for learner, _ in pairs]
        pairs.append((min(fitting, key=taken.count), scheme))
    left = learners.keys() - {learner for learner, _ in pairs}
    return sorted([*pairs, *((learner, learners[learner][0]) for learner in left)])


@pytest.mark.slow
@family(("learner", "scheme"), learners_and_schemes(), usual=3, fast=[])
def test_every_learner_and_scheme_trains_for_any_house(
    learner: str, scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = OmegaConf.load(conf_folder() / "agent" / f"{learner}.yaml")["_target_"]
    fits = constant(target, "fits") or {}
    trainer, reward = (
        fits.get(room, ["off_policy" if room == "trainer" else "individual"])[0]
        for room in ("trainer", "reward")
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "draw", lambda config, folder: None)
    # Validation measures it as a test does, and planners are the same for all.
    monkeypatch.setattr(train, "measure_all", only_load)
    chosen = [f"agent={learner}", f"comm={scheme}", f"trainer={trainer}", f"reward={reward}"]
    settings = [*TINY, *(f"trainer.{setting}" for setting in OF_TRAINERS[trainer])]
    settings += [SHORT, "evaluation.sides=[]"]
    settings += world_for(scheme)
    assert cli.main(["train", "+experiment=any_house_task", *chosen, *settings]) == 0
    [folder] = Path("runs").iterdir()
    rows = list(csv.DictReader((folder / "metrics.csv").read_text().splitlines()))
    assert all(math.isfinite(float(row["loss"])) for row in rows if row["loss"])
    assert int(rows[-1]["updates"]) >= 1
