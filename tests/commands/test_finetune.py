"""Training that starts from another run's weights: what is taken over, refused, reported."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from marl_clean import build, cli
from marl_clean.commands import train
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.stored import compose_for_policy, compose_for_training, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import read_entries
from marl_clean.storage.checkpoint import FOLDER, Checkpoints, load_weights
from tests.reliability import short_jobs

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]  # a run is trained

SMALL = [
    "house.rows=[5,6]",
    "house.cols=[5,6]",
    "train_houses=8",
    "env.num_envs=16",
    "env.max_steps=30",
    "encoder.channels=[4,4]",
    "encoder.strides=[2,2]",
    "encoder.hidden=[16]",
    "evaluation.houses=2",
    "evaluation.plans=[]",
    "trainer.total_frames=256",
    "trainer.frames_per_batch=128",
    "trainer.batch_frames=16",
    "trainer.replay_ratio=0.25",
    "trainer.start_frames=0",
    "trainer.eval_interval_frames=128",
    "trainer.log_interval_frames=128",
    "logger=[csv]",
]
HOME = ["experiment=finetune", "checkpoint=before", "house.path=home.txt", "house=drawn"]
BUDGET = ["trainer.total_frames=256", "trainer.start_frames=0"]
AT_HOME = [*HOME, *BUDGET, "trainer.eval_interval_frames=128", "trainer.frames_per_batch=64"]
PLAN = "#######\n#..#..#\n#.....#\n#..a..#\n#######\n"


@pytest.fixture(scope="module", autouse=True)
def trained(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a finished run and a plan; nothing is drawn here, on one thread."""
    place, threads = tmp_path_factory.mktemp("trained"), torch.get_num_threads()
    torch.set_num_threads(1)
    (place / "home.txt").write_text(PLAN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "draw", lambda cfg, folder: None)
        patch.chdir(place)
        assert cli.main(["train", *SMALL, "observation=frontier", "name=before"]) == 0
        yield place
    torch.set_num_threads(threads)


@pytest.fixture
def place(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with a finished run `before` and a plan `home.txt`."""
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_the_run_brings_its_config_and_the_preset_its_own(place: Path) -> None:
    config = compose_for_training(AT_HOME)
    assert config.observation._target_.endswith("Frontier")
    assert (config.encoder.channels, config.env.max_steps) == ([4, 4], 30)
    assert (config.agent.eps_init, config.agent.lr) == (0.1, 0.0003)
    assert (config.trainer.buffer_frames, config.trainer.total_frames) == (75_000, 256)
    assert (config.house.path, config.evaluation.plans) == ("home.txt", [])
    assert config.name.startswith("finetune-") and config.checkpoint == "runs/before"
    assert len(config.weights) == 64
    again = compose_for_training(["checkpoint=runs/before", "budget=small", "comm=plan"])
    assert again.trainer.total_frames == 1_000_000 and again.house.rows == [5, 6]


def test_other_weights_make_another_run(place: Path) -> None:
    config = compose_for_training(AT_HOME)
    weights = load_weights(Path("runs/before")).tree
    other = {name: weight + 1 for name, weight in weights.items()}
    shutil.copytree("runs/before", "runs/other")
    Checkpoints(Path("runs/other") / FOLDER).save("best", 999, other, {})
    changed = compose_for_training([*AT_HOME, "checkpoint=other"])
    assert changed.weights != config.weights and changed.name != config.name
    shutil.copytree("runs/before", "runs/moved")
    assert compose_for_training([*AT_HOME, "checkpoint=moved"]).name == config.name
    # what starts from nothing is called as ever, and how a policy is measured has no part in it
    assert config_hash(compose_config(["checkpoint=before"])) == config_hash(compose_config())
    measured = compose_for_policy(["checkpoint=before"])
    assert (measured.weights, measured.name) == (None, "before")


def test_before_and_after_at_home_and_in_the_old_houses(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["train", *AT_HOME, "name=after"]) == 0
    output = capsys.readouterr().out
    assert "2 houses (home.txt)" in output and "2 houses (test)" in output
    entries = read_entries(Path("runs/after/evaluation.json"))
    names = ["after", "before before", "random", "nearest_unknown", "nearest_unknown+greedy"]
    measured_in = [(entry["house_set"], entry["policy"]) for entry in entries]
    assert measured_in == [(houses, name) for houses in ("home.txt", "test") for name in names]
    assert [entry["epsilon"] for entry in entries[:3]] == [0.02, 0.02, 0.0]
    old = read_entries(Path("runs/before/evaluation.json"))
    assert entries[6]["houses"] == old[0]["houses"]  # the same weights in the same houses
    assert load_config(Path("runs/after"))["weights"] == compose_for_training(AT_HOME).weights
    # the same command again measures and trains nothing
    files = {path: path.stat().st_mtime_ns for path in Path("runs/after/checkpoints").rglob("*")}
    assert cli.main(["train", *AT_HOME, "name=after"]) == 0
    assert "is finished" in capsys.readouterr().out
    assert files == {
        path: path.stat().st_mtime_ns for path in Path("runs/after/checkpoints").rglob("*")
    }
    # and the tuned run can be measured, and tuned on
    assert cli.main(["evaluate", "checkpoint=after", "evaluation.houses=1"]) == 0
    assert compose_for_training(["checkpoint=after", "seed=1"]).house.path == "home.txt"


def test_training_starts_from_the_best_weights_in_both_networks(place: Path) -> None:
    cfg = compose_for_training(AT_HOME)
    agent = build.make_agent(cfg, build.make_env(cfg))
    build.start_from(agent, cfg)
    state, best = agent.state_dict(), load_weights(Path("runs/before")).tree
    for name, weight in best.items():
        assert torch.equal(state["network"][name], weight)
        assert torch.equal(state["target"][name], weight)
    cfg.weights = "0" * 64
    with pytest.raises(BadInput, match="have changed"):
        build.start_from(agent, cfg)


@pytest.mark.parametrize(("there", "here"), [("delayed", "perfect"), ("perfect", "delayed")])
def test_training_starts_over_another_channel_than_before(
    there: str, here: str, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    cfg = compose_config([*SMALL, f"channel={there}"])
    before = build.make_agent(cfg, build.make_env(cfg)).network.state_dict()
    Path("runs/over").mkdir(parents=True)
    Path("runs/over/config.yaml").write_text(OmegaConf.to_yaml(cfg))
    Checkpoints(Path("runs/over") / FOLDER).save("best", 1, before, {})
    cfg = compose_for_training(["checkpoint=over", f"channel={here}"])
    agent = build.make_agent(cfg, build.make_env(cfg))
    build.start_from(agent, cfg)
    state = agent.state_dict()
    assert state["network"].keys() == state["target"].keys()
    assert any("channel" in name for name in state["network"]) == (here == "delayed")
    for name, weight in state["network"].items():
        assert torch.equal(weight, state["target"][name])
        assert "channel" in name or torch.equal(weight, before[name])


@pytest.fixture
def unmeasured(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the measurement after training."""
    monkeypatch.setattr(train, "measure_all", lambda cfg, folder: [])


@pytest.mark.usefixtures("unmeasured")
def test_starting_weights_that_training_only_worsens_stay_the_best(place: Path) -> None:
    assert cli.main(["train", *AT_HOME, "name=worse", "agent.lr=1.0", "agent.lr_end=1.0"]) == 0
    best = load_weights(Path("runs/worse"))
    start = load_weights(Path("runs/before"))
    assert best.frames == 0
    assert all(torch.equal(weight, start.tree[name]) for name, weight in best.tree.items())


class Killed(BaseException):
    """Ends a run without a chance to save, as kill -9 does."""


@pytest.mark.long
@pytest.mark.usefixtures("unmeasured")
def test_a_killed_run_resumes_from_its_state_and_not_from_the_start(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = ["train", *AT_HOME, "trainer.checkpoint_interval_frames=64"]
    assert cli.main([*settings, "name=whole"]) == 0
    from marl_clean.trainer.off_policy import OffPolicyLoop

    learn = OffPolicyLoop.learn
    for block in (2, 3):

        def dying(self, played, block=block):
            learn(self, played)
            if self.frames >= 64 * block:
                raise Killed

        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(OffPolicyLoop, "learn", dying)
            cli.main([*settings, "name=killed"])
    assert cli.main([*settings, "name=killed"]) == 0
    rows = [Path(f"runs/{name}/metrics.csv").read_text() for name in ("whole", "killed")]
    assert rows[0] == rows[1]
    for kind in ("best", "final"):
        whole, killed = (
            Checkpoints(Path("runs") / name / FOLDER).newest(kind) for name in ("whole", "killed")
        )
        assert (whole.frames, whole.notes) == (killed.frames, killed.notes)
        assert all(torch.equal(weight, killed.tree[name]) for name, weight in whole.tree.items())


REFUSED = {
    "checkpoint=befor": "did you mean before?",
    "checkpoint=empty": "has no whole weights yet",
    "experiment=finetune": "there is no such run; runs: any_house, approach_2_frontier, before, ",
    "experiment=finetune checkpoint=before": "house.path: null",
    "experiment=finetune checkpoint=before house.path=flat.yaml": "no file 'flat.yaml'",
    "experiment=paper_proximity checkpoint=before": (
        "observation._target_: marl_clean.observation.crop"
    ),
    "checkpoint=before observation.view_size=13": "observation.view_size: 13 does not fit",
    "checkpoint=before comm=none": "does not fit checkpoint before",
    "checkpoint=before parameter_budget=9000": "parameter_budget: 9000 does not fit",
    "checkpoint=before encoder.channels=[4,5]": "encoder.channels",
    "checkpoint=before agent.dueling=false": "agent.dueling: False does not fit",
    "checkpoint=before agent.lrr=1": "did you mean lr?",
    "checkpoint=before seed=1,2": "train -m",
    "checkpoint=before weights=abc": "weights: must be left out",
    "weights=abc": "weights: must be left out",
    "-m checkpoint=before,befor seed=1": "did you mean before?",
}


@pytest.mark.parametrize("settings", REFUSED)
def test_what_does_not_fit_is_one_line_and_no_folder(
    place: Path, settings: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("runs/empty").mkdir()
    OmegaConf.save(compose_config(["name=empty"]), "runs/empty/config.yaml")
    folders = set(Path("runs").iterdir())
    assert cli.main(["train", *settings.split()]) == cli.BAD_INPUT
    out, error = capsys.readouterr()
    assert REFUSED[settings] in error and error.count("\n") == 1 and out == ""
    assert set(Path("runs").iterdir()) == folders


def test_old_houses_that_are_gone_are_met_before_training(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = OmegaConf.load("runs/before/config.yaml")
    config.house = compose_config(["house=drawn", "house.path=gone.txt"]).house
    OmegaConf.save(config, "runs/before/config.yaml")
    assert cli.main(["train", *AT_HOME]) == cli.BAD_INPUT
    assert "checkpoint=runs/before: its houses: house.path: no file" in capsys.readouterr().err


def test_learning_may_change_where_the_network_stays(place: Path) -> None:
    settings = ["encoder.dropout=0.2", "agent.gamma=0.9", "agent.precision=float32", "reward=team"]
    config = compose_for_training(["checkpoint=before", "topology=full", *settings])
    assert (config.encoder.dropout, config.agent.gamma) == (0.2, 0.9)
    assert config.reward._target_.endswith("Team")


@pytest.mark.long
def test_a_sweep_starts_every_job_from_the_run(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train, "draw", short_jobs.draw)
    sweep = ["train", "-m", "hydra/launcher=basic", "hydra/hydra_logging=none", *AT_HOME]
    assert cli.main([*sweep, "seed=1,2", "trainer.total_frames=128", "evaluation.houses=1"]) == 0
    tuned = [load_config(path) for path in Path("runs").glob("finetune-*")]
    assert sorted(config["seed"] for config in tuned) == [1, 2]
    assert {config["weights"] for config in tuned} == {compose_for_training(AT_HOME).weights}
    assert {tuple(config["encoder"]["channels"]) for config in tuned} == {(4, 4)}


def test_a_run_that_lacks_later_keys_is_completed(place: Path) -> None:
    path = Path("runs/before/config.yaml")
    plain = OmegaConf.load(path)
    whole = load_config(Path("runs/before"))
    del plain["weights"], plain["trainer"]["curriculum_stages"]
    del plain["channel"], plain["evaluation"]["team_sizes"], plain["encoder"]["memory"]
    OmegaConf.save(plain, path)
    assert load_config(Path("runs/before")) == whole
    config = compose_for_training(["checkpoint=before", "trainer.curriculum_stages=2"])
    assert config.trainer.curriculum_stages == 2
    del plain["trainer"]["total_frames"]
    OmegaConf.save(plain, path)
    with pytest.raises(BadInput, match="trainer.total_frames: is missing"):
        load_config(Path("runs/before"))
