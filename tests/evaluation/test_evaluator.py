"""Every policy meets the same houses from the same starts, and nothing global is touched."""

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, exploration_type, set_exploration_type

from marl_clean import build
from marl_clean.config.compose import compose_config
from marl_clean.evaluation import evaluator, rollouts
from marl_clean.evaluation.evaluator import (
    evaluate,
    measure_beside_planners,
    measure_planner,
    validate,
)
from marl_clean.keys import ACTION, ADJACENCY, MESSAGE_BITS, OBSERVATION

SMALL = [
    "house.rows=[5, 6]",
    "house.cols=[5, 9]",
    "train_houses=8",
    "evaluation.houses=6",
    "env.max_steps=40",
]


@pytest.fixture(scope="module")
def cfg():
    return compose_config(SMALL)


class Spread(TensorDictModuleBase):
    """A network's stand-in: acts by what each robot sees, and sends a message along its edges."""

    in_keys = [OBSERVATION, ADJACENCY]
    out_keys = [ACTION, MESSAGE_BITS]

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[int] = []
        self.modes: list[bool] = []

    def forward(self, td: TensorDictBase) -> TensorDictBase:
        self.asked.append(len(td))
        self.modes.append(self.training)
        seen = (td[OBSERVATION].flatten(2) * 1000).round().long()
        weights = torch.arange(seen.shape[2], device=seen.device) % 7
        td[ACTION] = (seen * weights).sum(2) % 4
        td[MESSAGE_BITS] = td[ADJACENCY].sum(-1, keepdim=True) * 32.0
        return td


def run(cfg, policy=None, count=6, **settings):
    policy = policy or Spread()
    return evaluate(cfg, lambda env: policy, house_set="test", count=count, **settings)


@pytest.mark.slow
def test_house_i_is_test_seed_i_and_starts_do_not_depend_on_policy_or_run_seed(cfg):
    first = run(cfg)
    other = cfg.copy()
    other.seed = 7
    second = evaluate(other, lambda env: build.make_planner(cfg, env), house_set="test", count=6)
    assert [record["seed"] for record in first] == list(range(2_000_000, 2_000_006))
    assert run(other, epsilon=0.3) == run(cfg, epsilon=0.3)
    names = ("seed", "rows", "cols", "free_cells", "bound_90", "bound_100", "bound_certify")
    for record, other_record in zip(first, second, strict=True):
        assert [record[name] for name in names] == [other_record[name] for name in names]


@pytest.mark.slow
def test_the_same_evaluation_gives_the_same_records_and_leaves_global_randomness_alone(cfg):
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first = run(cfg, epsilon=0.3)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(6)
    assert run(cfg, epsilon=0.3) == first


def test_epsilon_replaces_that_share_of_each_robots_actions(cfg):
    env = build.make_env(cfg, build.held_out_houses(cfg, "test", 1), num_envs=500)
    env.reset()
    base = env.base_env
    acted = torch.full((500, 2), 3)
    random = evaluator.with_random_actions(base, acted, 0.4)
    assert (random != 3).float().mean() == pytest.approx(0.3, abs=0.05)
    changed = random != 3
    assert not torch.equal(changed[:, 0], changed[:, 1])
    assert torch.equal(evaluator.with_random_actions(base, acted, 0.0), acted)


@pytest.mark.slow
def test_the_network_does_not_act_in_finished_episodes_and_records_are_the_same(cfg, monkeypatch):
    policy = Spread().train()
    long = cfg.copy()
    long.env.max_steps = 150
    records = run(long, policy, epsilon=0.5)
    finished = [record["T_100"] for record in records]
    assert min(time or 150 for time in finished) < max(time or 150 for time in finished)
    assert policy.asked[0] == 6 and policy.asked[-1] < 6
    assert not any(policy.modes) and policy.training  # dropout is off, and on again
    monkeypatch.setattr(rollouts, "act_in_running", lambda policy, td, running: policy(td))
    assert run(long, Spread(), epsilon=0.5) == records


@pytest.mark.slow
def test_messages_are_counted_only_while_an_episode_runs(cfg):
    for record in run(cfg):
        assert record["bits"] == pytest.approx(32 * record["messages"])
        assert record["messages"] == pytest.approx(2 * record["edges"])


@pytest.mark.slow
def test_chunks_bound_the_memory_and_know_their_houses(cfg, monkeypatch):
    whole = run(cfg)
    monkeypatch.setattr(evaluator, "CELLS_AT_ONCE", 4 * 6 * 9)
    parts = run(cfg)
    assert [record["seed"] for record in parts] == [record["seed"] for record in whole]
    assert parts[:4] == whole[:4]
    assert [r["free_cells"] for r in parts] == [r["free_cells"] for r in whole]


@pytest.mark.slow
def test_a_loaded_plan_is_one_house_started_as_often():
    plan = compose_config(["house=drawn", "evaluation.houses=3", "env.max_steps=5"])
    entry = measure_planner(plan)
    records = entry["houses"]
    assert len(records) == 3 and "seed" not in records[0]
    assert entry["house_set"] == records[0]["path"]
    assert len({record["free_cells"] for record in records}) == 1


@pytest.mark.slow
def test_certify_continues_the_episode_and_changes_nothing_else(cfg):
    def planner(env):
        return build.make_planner(cfg, env)

    plain = evaluate(cfg, planner, house_set="test", count=6)
    certified = evaluate(cfg, planner, house_set="test", count=6, certify=True)
    for longer, shorter in zip(certified, plain, strict=True):
        assert {name: longer[name] for name in shorter} == shorter
    for record in certified:
        if record["T_certify"] is not None:
            assert record["T_certify"] >= record["bound_certify"]


@pytest.mark.slow
def test_a_learned_policy_stands_beside_the_planners(cfg):
    entries = list(measure_beside_planners(cfg, Spread(), "mine"))
    names = [entry["policy"] for entry in entries]
    assert names == ["mine", "random", "nearest_unknown", "nearest_unknown+greedy"]
    assert [entry["epsilon"] for entry in entries] == [0.02, 0.0, 0.0, 0.0]
    assert {entry["house_set"] for entry in entries} == {"test"}
    times = {entry["policy"]: entry["summary"]["T_90"]["mean"] for entry in entries}
    assert times["nearest_unknown"] < times["random"]


@pytest.mark.slow
def test_weights_are_chosen_on_other_houses_than_they_are_tested_on(cfg):
    means = validate(cfg, Spread())
    records = evaluate(
        cfg, lambda env: Spread(), house_set="validation", count=6, epsilon=cfg.evaluation.epsilon
    )
    assert [record["seed"] for record in records] == list(range(1_000_000, 1_000_006))
    assert means["finished"] == sum(record["T_100"] is not None for record in records) / 6
    times = [record["T_90"] or record["max_steps"] for record in records]
    assert means["T_90"] == pytest.approx(sum(times) / 6)


def test_policies_act_without_gradients_and_callers_keep_their_modes(cfg):
    env, modes = build.make_env(cfg), []
    policy = Spread()

    def act(policy, frame, running):
        modes.append((torch.is_grad_enabled(), exploration_type()))
        return policy(frame)

    first = rollouts.first_frame(env, policy)
    steps = rollouts.rollout_episodes(env, policy, first, act=act)
    with set_exploration_type(ExplorationType.RANDOM):
        next(steps)
        assert torch.is_grad_enabled() and exploration_type() == ExplorationType.RANDOM
        assert modes == [(False, ExplorationType.DETERMINISTIC)]
