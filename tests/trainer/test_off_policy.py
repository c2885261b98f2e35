"""The training loop: it learns what needs a message, and goes on exactly where it was stopped."""

import os
import signal
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from marl_clean.errors import BadInput
from marl_clean.logger.csv import Csv
from marl_clean.logger.tensorboard import TensorBoard
from marl_clean.storage.checkpoint import FOLDER, Checkpoints, load_weights
from marl_clean.storage.finite import Diverged
from marl_clean.trainer._outcome import Outcome
from marl_clean.trainer.off_policy import OffPolicy
from tests.agent.parts import make_agent, make_encoder
from tests.trainer.probe import Probe, share_right

pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")

SETTINGS = {
    "total_frames": 480,
    "frames_per_batch": 48,
    "buffer_frames": 250,
    "batch_frames": 16,
    "replay_ratio": 0.8,
    "start_frames": 60,
    "log_interval_frames": 90,
    "eval_interval_frames": 144,
    "checkpoint_interval_frames": 128,
    "select_by": "return",
}


def train(folder: Path, env=None, evaluate=None, agent=None, loggers=(), **changes) -> Outcome:
    """Train as a process of its own would: everything new but the folder."""
    folder.mkdir(exist_ok=True)
    trainer = OffPolicy(**(SETTINGS | changes))
    agent = agent or make_agent("plan", gamma=0.5, precision="bfloat16", augment=True)
    torch.manual_seed(0)
    return trainer.train(
        env or Probe(),
        agent,
        evaluate or (lambda policy: {"return": share_right(policy), "finished": 0.5}),
        [Csv(folder), *loggers],
        folder,
    )


def results(folder: Path) -> tuple:
    final = Checkpoints(folder / FOLDER).newest("final")
    best = load_weights(folder)
    return (folder / "metrics.csv").read_text(), final, best


def assert_same_results(run: Path, other: Path) -> None:
    (rows, *checkpoints), (other_rows, *others) = results(run), results(other)
    assert rows == other_rows
    for saved, other in zip(checkpoints, others, strict=True):
        assert (saved.frames, saved.notes) == (other.frames, other.notes)
        assert saved.tree.keys() == other.tree.keys()
        assert all(torch.equal(weight, other.tree[name]) for name, weight in saved.tree.items())


class Signalling(Probe):
    """Sends this process a signal in a given step."""

    def __init__(self, at: int, number: signal.Signals, **settings):
        super().__init__(**settings)
        self.at, self.number = at, number

    def _step(self, tensordict):
        if self.steps_taken == self.at:
            os.kill(os.getpid(), self.number)
        return super()._step(tensordict)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "uninterrupted"
    torch.set_num_threads(1)
    train(folder, loggers=[TensorBoard(folder)])
    return folder


@pytest.mark.slow
def test_a_run_leaves_its_rows_and_weights_and_no_states(uninterrupted):
    rows = (uninterrupted / "metrics.csv").read_text().splitlines()
    columns = rows[0].split(",")
    assert columns[0] == "frames"
    assert {"loss", "grad_norm", "epsilon", "updates", "coverage", "validation/return"} <= {
        *columns
    }
    assert not any(name.startswith("time/") for name in columns)
    frames = [int(row.split(",")[0]) for row in rows[1:]]
    assert frames == sorted(set(frames))
    assert frames[-1] == 480
    last = dict(zip(columns, rows[-1].split(","), strict=True))
    assert int(last["updates"]) == int((480 - 60) * 0.8 / 16)
    kinds = {path.name.partition("-")[0] for path in (uninterrupted / FOLDER).iterdir()}
    assert kinds == {"best", "final"}
    assert list((uninterrupted / "tensorboard").glob("events*"))


def test_a_finished_run_says_so_and_does_nothing(uninterrupted):
    before = (uninterrupted / "metrics.csv").read_bytes()
    outcome = train(uninterrupted, env=Probe(bad_reward_at=1))
    assert outcome.was_finished
    assert outcome.frames == 480
    assert outcome.best["return"] == load_weights(uninterrupted).notes["return"]
    assert (uninterrupted / "metrics.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "number", "code"),
    [([17], signal.SIGINT, 130), ([2, 13, 26], signal.SIGTERM, 143)],
)
def test_an_interrupted_run_goes_on_exactly(tmp_path, uninterrupted, steps, number, code):
    folder = tmp_path / "run"
    for step in steps:
        with pytest.raises(SystemExit) as stopped:
            train(folder, env=Signalling(step, number))
        assert stopped.value.code == code
        assert Checkpoints(folder / FOLDER).newest("state") is not None
    assert not train(folder).was_finished
    assert_same_results(folder, uninterrupted)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


class Killed(BaseException):
    """Ends a run without a chance to save, as kill -9 does."""


@pytest.mark.slow
@pytest.mark.parametrize("step", [1, 8, 19, 27])
def test_a_killed_run_goes_on_from_its_last_state(tmp_path, uninterrupted, step, monkeypatch):
    folder = tmp_path / "run"

    class Dying(Probe):
        def _step(self, tensordict):
            if self.steps_taken == step:
                raise Killed
            return super()._step(tensordict)

    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(Csv, "close", lambda self: None)
        train(folder, env=Dying())
    with (folder / "metrics.csv").open("a") as file:
        file.write("450,torn")
    train(folder)
    assert_same_results(folder, uninterrupted)


@pytest.mark.slow
def test_a_signal_breaks_off_an_evaluation_which_is_done_again(tmp_path, uninterrupted):
    folder = tmp_path / "run"
    asked = 0

    def evaluate(policy):
        nonlocal asked
        asked += 1
        if asked == 2:
            os.kill(os.getpid(), signal.SIGTERM)
            raise AssertionError("goes on after the signal")
        return {"return": share_right(policy), "finished": 0.5}

    with pytest.raises(SystemExit) as stopped:
        train(folder, evaluate=evaluate)
    assert stopped.value.code == 143
    train(folder, evaluate=evaluate)
    assert_same_results(folder, uninterrupted)


@pytest.mark.slow
def test_an_evaluation_that_draws_random_numbers_changes_nothing(tmp_path, uninterrupted):
    def evaluate(policy):
        torch.rand(1000)
        return {"return": share_right(policy), "finished": 0.5}

    train(tmp_path / "run", evaluate=evaluate)
    assert_same_results(tmp_path / "run", uninterrupted)


@pytest.mark.slow
def test_a_damaged_state_goes_back_to_the_one_before(tmp_path, uninterrupted, caplog):
    folder = tmp_path / "run"
    with pytest.raises(SystemExit):
        train(folder, env=Signalling(22, signal.SIGTERM))
    newest = max((folder / FOLDER).glob("state-*"))
    content = bytearray((newest / "tensors.safetensors").read_bytes())
    content[len(content) // 2] ^= 1
    (newest / "tensors.safetensors").write_bytes(content)
    train(folder)
    assert "going back" in caplog.text
    assert_same_results(folder, uninterrupted)


@pytest.mark.slow
def test_best_weights_are_those_of_the_best_evaluation(tmp_path):
    scores = iter([3.0, 1.0, 1.0, 2.0])
    seen = []

    def evaluate(policy):
        weights = policy.network.head.weight
        seen.append(weights.clone())
        return {"T_100": next(scores)}

    train(tmp_path / "run", evaluate=evaluate, select_by="T_100")
    best = load_weights(tmp_path / "run")
    assert (best.frames, best.notes) == (288, {"T_100": 1.0})
    assert torch.equal(best.tree["head.weight"], seen[1])


@pytest.mark.slow
def test_a_measure_that_does_not_exist_is_named_with_the_valid_ones(tmp_path):
    with pytest.raises(BadInput, match=r"trainer\.select_by=T_99: valid: finished, return"):
        train(tmp_path / "run", select_by="T_99")


def test_blocks_must_fill_all_worlds(tmp_path):
    with pytest.raises(BadInput, match=r"must be a multiple of env.num_envs=16, such as 48"):
        train(tmp_path / "run", frames_per_batch=50)


@pytest.mark.slow
def test_a_bad_reward_stops_the_run_before_it_is_saved(tmp_path):
    with pytest.raises(Diverged, match=r"frame 336: a reward is NaN or infinite"):
        train(tmp_path / "run", env=Probe(bad_reward_at=20))
    state = Checkpoints(tmp_path / "run" / FOLDER).newest("state")
    assert state.frames == 288
    assert state.tree["replay"]["frames"]["next", "agents", "reward"].isfinite().all()


def test_a_diverging_network_stops_the_run_before_it_is_saved(tmp_path):
    agent = make_agent("plan")

    def evaluate(policy):
        with torch.no_grad():
            agent.network.head.bias.fill_(torch.inf)
        return {"return": 0.0}

    with pytest.raises(Diverged, match=r"weight head.bias|update \d+, frame 1\d\d: loss is NaN"):
        train(tmp_path / "run", agent=agent, evaluate=evaluate)
    for path in (tmp_path / "run" / FOLDER).glob("*/tensors.safetensors"):
        tensors = load_file(path).values()
        assert all(tensor.isfinite().all() for tensor in tensors if tensor.is_floating_point())


@pytest.mark.long
def test_the_probe_is_solved_by_talking_both_ways_at_once(tmp_path):
    assert right_on_the_probe(tmp_path, "plan") > 0.9


@pytest.mark.long
def test_the_probe_is_not_solved_in_silence(tmp_path):
    assert 0.1 <= right_on_the_probe(tmp_path, "none") <= 0.45


def right_on_the_probe(folder: Path, comm: str, frames: int = 4096) -> float:
    agent = make_agent(comm, gamma=0.3, lr=4e-3, lr_end=4e-3, n_steps=1, annealing_fraction=0.6)
    trained = {"batch_frames": 64, "replay_ratio": 4.0, "buffer_frames": 5000}
    whole = ("total", "log_interval", "eval_interval", "checkpoint_interval")
    trained |= {f"{name}_frames": frames for name in whole}  # nothing is saved on the way
    train(folder / "run", agent=agent, **trained)
    return share_right(agent.policy(), worlds=256)


@pytest.mark.slow
def test_dropout_is_off_where_it_acts(tmp_path):
    agent = make_agent("plan", encoder=make_encoder(dropout=0.5))
    train(tmp_path / "run", agent=agent)
    assert not any(module.training for module in agent.network.encoder.connected)
