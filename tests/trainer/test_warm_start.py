"""A planner acts first: what each learner learns from it, and when the learner itself acts."""

import pytest
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import build, keys
from marl_clean.commands.checks import check_imitate
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.errors import BadInput
from marl_clean.learning.agent import Agent
from marl_clean.learning.losses import MARGIN, cross_entropy, margin_loss
from marl_clean.logger.csv import Csv
from marl_clean.planner.nearest_unknown import NearestUnknown
from marl_clean.settings import StatesOf
from marl_clean.storage.checkpoint import FOLDER, Checkpoints
from marl_clean.trainer._warm_start import WarmStart
from marl_clean.trainer.off_policy import OffPolicy
from tests.agent.parts import LEARNERS, make_agent
from tests.families import family
from tests.trainer.killing import Killed, kill_after
from tests.trainer.probe import Probe
from tests.trainer.test_off_policy import SETTINGS

SMALL = [
    "env.num_envs=8",
    "env.n_agents=2",
    "env.max_steps=9",
    "observation.view_size=9",
    "encoder.channels=[6,8]",
    "encoder.strides=[2,2]",
    "encoder.hidden=[24]",
    "house=rooms",
    "house.rows=[5,7]",
    "house.cols=[5,8]",
    "train_houses=20",
    "agent.precision=float32",
]
ON_POLICY = ("pqn", "ippo", "mappo")
OF_LOOPS = {
    "off_policy": ["batch_frames=16", "replay_ratio=0.5", "start_frames=64", "buffer_frames=300"],
    "on_policy": ["epochs=2", "minibatch_frames=32"],
}


def settings(level: str, *others: str) -> list[str]:
    loop = "on_policy" if level in ON_POLICY else "off_policy"
    comm = ["comm=none", "reward=team"] if level == "central_dqn" else ["reward=team"]
    of_loop = [f"trainer.{setting}" for setting in OF_LOOPS[loop]]
    return [*SMALL, f"agent={level}", f"trainer={loop}", *comm, *of_loop, *others]


def shown(level: str, *others: str, epsilon: float = 0.0, states: StatesOf = "planner"):
    """A learner, its warm start by nearest_unknown, and frames of it."""
    config = compose_config(settings(level, *others))
    torch.manual_seed(0)
    env = build.make_env(config)
    agent = build.make_agent(config, env)
    env = build.ready_for(agent, env)
    start = WarmStart(agent, env, "nearest_unknown", until=100.0, states=states)
    if level not in ("ippo", "mappo"):
        for coin in agent.exploring._coins:
            coin.eps.fill_(epsilon)
    return agent, env, start


def collected(env, start: WarmStart):
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        return env.rollout(12, start.policy, break_when_any_done=False).contiguous()


def test_the_margin_by_hand() -> None:
    value = torch.tensor([[1.0, 3.0, 2.5, 0.0], [1.0, 3.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0]])
    demonstrated = torch.tensor([2, 1, -1])
    expected = torch.tensor([3.0 + MARGIN - 2.5, 0.0, 0.0]).mean()
    torch.testing.assert_close(margin_loss(value, demonstrated), expected)


def test_cross_entropy_by_hand() -> None:
    logits = torch.randn(5, 2, 4)
    demonstrated = torch.tensor([[0, 1], [2, 3], [-1, 0], [1, -1], [-1, -1]])
    chance = logits.softmax(-1)
    sum_ = sum(
        -chance[i, j, demonstrated[i, j]].log()
        for i in range(5)
        for j in range(2)
        if demonstrated[i, j] >= 0
    )
    torch.testing.assert_close(cross_entropy(logits, demonstrated), sum_ / 10)


@pytest.mark.parametrize("loss", [margin_loss, cross_entropy])
def test_masked_actions_are_not_imitated(loss) -> None:
    least = torch.finfo(torch.float32).min
    value = torch.tensor([[1.0, least, 2.0, 0.0]], requires_grad=True)
    result = loss(value, torch.tensor([1]))
    assert result == 0
    result.backward()
    assert not value.grad.any()


@family("level", LEARNERS, fast=2)
def test_the_planner_acts_first_and_the_learner_then(level: str) -> None:
    agent, env, start = shown(level)
    start.at(99)
    frames = collected(env, start)
    assert torch.equal(frames[keys.ACTION], frames[keys.DEMONSTRATION])
    assert set(frames[keys.DEMONSTRATION].unique().tolist()) <= {0, 1, 2, 3}
    start.at(100)
    own = collected(env, start)
    assert (own[keys.DEMONSTRATION] == -1).all()
    assert keys.DEMONSTRATION in agent.learns_from
    assert set(own.keys(True, True)) == set(frames.keys(True, True))


@family("level", LEARNERS, fast=2)
def test_a_planner_says_what_it_would_do_where_the_learner_goes(level: str) -> None:
    agent, env, start = shown(level, states="learner")
    planner = NearestUnknown().bind(env.base_env)
    start.at(99)
    frame, others = env.reset(), 0
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        for _ in range(12):
            would_do = planner.act()
            frame, later = env.step_and_maybe_reset(start.policy(frame))
            assert torch.equal(frame[keys.DEMONSTRATION], would_do)
            others += int((frame[keys.ACTION] != would_do).sum())
            frame = later
    assert others
    start.at(100)
    assert (collected(env, start)[keys.DEMONSTRATION] == -1).all()


@pytest.mark.slow
def test_the_planner_acts_less_and_less_in_states_of_the_learner() -> None:
    _, env, start = shown("ippo", "env.num_envs=64", states="learner")
    for frames, share in ((0, 1.0), (25, 0.75), (75, 0.25)):
        start.at(frames)
        acts = []
        for _ in range(20):
            frame = env.reset()
            frame[keys.ACTION] = torch.full((64, 2), -1)
            acts.append(start.demonstrator(frame)[keys.ACTION] >= 0)
        taken = torch.stack(acts)
        assert abs(taken.float().mean().item() - share) < 0.05
        assert torch.equal(taken[..., 0], taken[..., 1])  # in a world the planner, or the learner


@pytest.mark.slow
def test_demonstrations_are_recorded_where_a_robot_acts_at_random() -> None:
    _, env, start = shown("iql", epsilon=0.5)
    start.at(0)
    frames = collected(env, start)
    other = (frames[keys.ACTION] != frames[keys.DEMONSTRATION]).float().mean().item()
    assert 0.25 < other < 0.5  # of half of the actions a quarter is the same
    assert (frames[keys.DEMONSTRATION] >= 0).all()


def agreement(agent: Agent, frames) -> float:
    with torch.no_grad():
        acted = agent.policy()(frames.select(*agent.policy().in_keys))[keys.ACTION]
    return (acted == frames[keys.DEMONSTRATION]).float().mean().item()


@family("level", LEARNERS, fast=1, usual=3)
def test_every_learner_imitates_the_demonstrations(level: str) -> None:
    agent, env, start = shown(level, "agent.lr=0.003", "agent.mask_walls=true")
    start.at(0)
    frames = collected(env, start)
    learnt = frames.select(*agent.learns_from)
    if level in ON_POLICY:
        learnt = agent.estimate(learnt)
    else:
        learnt[keys.STEPS_TO_NEXT_OBS] = torch.ones(learnt.batch_size, dtype=torch.int64)
    enough = max(0.65, agreement(agent, frames) + 0.2)
    for update in range(150):
        measured = agent.update(learnt.flatten())
        assert all(value.isfinite() for value in measured.values())
        if update % 10 == 9 and agreement(agent, frames) > enough:
            return
    pytest.fail(f"agrees in {agreement(agent, frames):.2f} after 150 updates, not in {enough:.2f}")


@family("level", ["iql", "pqn", "ippo"], fast=1)
def test_rows_are_imitated_too(level: str) -> None:
    agent, env, start = shown(level, "encoder.memory=gru")
    start.at(0)
    learnt = collected(env, start).select(*agent.learns_from)
    if level == "iql":
        learnt[keys.STEPS_TO_NEXT_OBS] = torch.ones(learnt.batch_size, dtype=torch.int64)
    else:
        learnt = agent.estimate(learnt)
    assert agent.update(learnt)["loss"].isfinite()


@pytest.mark.slow
def test_ppo_learns_by_its_own_loss_once_it_acts() -> None:
    agent, env, start = shown("ippo")
    for frames, measure in ((0, "imitation"), (100, "clip_fraction")):
        start.at(frames)
        block = collected(env, start).select(*agent.learns_from)
        assert measure in agent.update(agent.estimate(block).flatten())


@pytest.mark.slow
def test_rotated_frames_have_rotated_demonstrations() -> None:
    agent, env, start = shown("iql", "agent.augment=true")
    start.at(0)
    learnt = collected(env, start).select(*agent.learns_from).flatten()
    learnt[keys.STEPS_TO_NEXT_OBS] = torch.ones(learnt.batch_size, dtype=torch.int64)
    rotated = agent._frames_to_learn(learnt)
    assert torch.equal(rotated[keys.ACTION], rotated[keys.DEMONSTRATION])
    assert not torch.equal(rotated[keys.ACTION], learnt[keys.ACTION])


def train(folder, overrides: list[str], die_after: int | None = None) -> None:
    folder.mkdir(exist_ok=True)
    cfg = compose_config(overrides)
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    env = build.ready_for(agent, env)
    if die_after is not None:
        kill_after(env, die_after)
    instantiate(cfg.trainer).train(env, agent, lambda policy: {"T_100": 1.0}, [Csv(folder)], folder)


@pytest.mark.long
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize(
    ("level", "planner", "states"),
    [
        ("iql", "smart_dfs", "planner"),
        ("pqn", "nearest_unknown", "learner"),
        ("ippo", "spiral", "planner"),
    ],
)
def test_a_killed_run_ends_as_the_uninterrupted_one(
    tmp_path, level: str, planner: str, states: str
) -> None:
    often = ["log_interval_frames=128", "eval_interval_frames=256"]
    often += ["total_frames=320", "frames_per_batch=64", "checkpoint_interval_frames=128"]
    shows = [f"imitate={planner}", "imitate_frames_share=0.6", f"imitate_states={states}"]
    overrides = settings(level, *(f"trainer.{setting}" for setting in (*often, *shows)))
    train(tmp_path / "whole", overrides)
    with pytest.raises(Killed):
        train(tmp_path / "killed", overrides, die_after=22)  # while the planner acts, up to 192
    train(tmp_path / "killed", overrides)
    rows = [(tmp_path / name / "metrics.csv").read_text() for name in ("whole", "killed")]
    assert rows[0] == rows[1]
    whole, killed = (
        Checkpoints(tmp_path / name / FOLDER).newest("final").tree for name in ("whole", "killed")
    )
    assert all(torch.equal(weight, killed[name]) for name, weight in whole.items())


def test_an_unknown_planner_is_refused_with_the_valid_names() -> None:
    valid = "boustrophedon, nearest_unknown, random, smart_dfs, spiral, null"
    with pytest.raises(BadInput, match=f"^trainer.imitate=me: is no planner; valid: {valid}$"):
        check_imitate(compose_config(["trainer.imitate=me"]))
    check_imitate(compose_config(["trainer.imitate=spiral"]))


@pytest.mark.slow
def test_without_houses_no_planner_can_be_imitated(tmp_path) -> None:
    with pytest.raises(BadInput, match="^trainer.imitate=spiral: planners need houses"):
        check_imitate(compose_config(["+experiment=spread", "trainer.imitate=spiral"]))
    trainer = OffPolicy(**SETTINGS, imitate="spiral")
    with pytest.raises(BadInput, match="^trainer.imitate=spiral: planners need houses"):
        trainer.train(Probe(), make_agent("none"), lambda policy: {}, [], tmp_path)
