"""External tasks under our learners: the same episodes as without us, and what a run leaves."""

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete
from mpe2 import simple_spread_v3
from pettingzoo import ParallelEnv
from rich.console import Console
from torch import nn
from torchrl.envs.utils import check_env_specs

from marl_clean import build, cli, keys, load_policy, make_env
from marl_clean.commands import compare
from marl_clean.commands import train as command
from marl_clean.config import schema
from marl_clean.config.compose import compose_config
from marl_clean.env import pettingzoo
from marl_clean.errors import BadInput
from marl_clean.evaluation.episodes import run_episodes
from tests.families import family

SPREAD = ["experiment=spread", "env.num_envs=3"]
SHORT = [
    "trainer.total_frames=1056",
    "trainer.frames_per_batch=96",
    "trainer.start_frames=200",
    "trainer.replay_ratio=0.25",
    "trainer.batch_frames=16",
    "trainer.buffer_frames=1000",
    "trainer.log_interval_frames=240",
    "trainer.eval_interval_frames=528",
    "trainer.checkpoint_interval_frames=240",
    "evaluation.houses=4",
]


class Count(ParallelEnv[str, np.ndarray, int]):
    """Agents see the seed and the step; in step `end` of an episode the first is over."""

    metadata = {"name": "count_v0"}

    def __init__(self, end: int = 3, terminates: bool = True, **kinds: Any) -> None:
        self.end, self.terminates = end, terminates
        self.possible_agents = ["b", "a"]  # in the task's order, whatever their names
        self.seen = kinds.get("seen", [Box(0, 2**32, (2, 1), np.int64)] * 2)
        self.does = kinds.get("does", [Discrete(5)] * 2)
        self.late = kinds.get("late", 0)

    def observation_space(self, agent: str) -> Any:
        return self.seen[self.possible_agents.index(agent)]

    def action_space(self, agent: str) -> Any:
        return self.does[self.possible_agents.index(agent)]

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.seed, self.steps = seed or 0, 0
        self.agents = self.possible_agents[self.late :]
        return self._now(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        self.steps += 1
        over = {agent: self.steps == self.end and agent == "b" for agent in self.agents}
        no = dict.fromkeys(self.agents, False)
        reward = {agent: float(actions[agent] + 10 * (agent == "a")) for agent in self.agents}
        endings = (over, no) if self.terminates else (no, over)
        return self._now(), reward, *endings, {agent: {} for agent in self.agents}

    def _now(self) -> dict[str, np.ndarray]:
        return {agent: np.array([[self.seed], [self.steps]]) for agent in self.agents}


@pytest.fixture
def copies(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Copies of `Count`, whose settings a test may change, in the place of any task."""
    kinds: dict[str, Any] = {}
    ends = iter(range(3, 100))
    monkeypatch.setattr(
        pettingzoo, "make_parallel", lambda task, options: Count(**({"end": next(ends)} | kinds))
    )
    yield kinds


@pytest.mark.slow
def test_it_is_an_env_by_torchrls_rules() -> None:
    env = make_env(SPREAD)
    check_env_specs(env)
    assert env.full_action_spec[keys.ACTION].n == 5
    assert env.observation_spec[keys.OBSERVATION].shape == (3, 3, 18)


@pytest.mark.slow
def test_it_steps_as_the_bare_tasks_do() -> None:
    env = make_env([*SPREAD, "reward=individual", "env.options={N: 2, max_cycles: 7}"])
    env.set_seed(11)
    td = env.reset()
    bare = [simple_spread_v3.parallel_env(N=2, max_cycles=7) for _ in range(3)]
    seen = [
        copy.reset(seed=seed)[0]
        for copy, seed in zip(bare, env.base_env.episode_seeds.tolist(), strict=True)
    ]
    draw = torch.Generator().manual_seed(0)
    for step in range(20):  # nearly three episodes
        for row, copy in enumerate(bare):
            actual = td[keys.OBSERVATION][row].numpy()
            assert (actual == np.stack([seen[row][agent] for agent in copy.possible_agents])).all()
        td[keys.ACTION] = torch.randint(5, (3, 2), generator=draw)
        before = td[keys.ACTION].clone()
        stepped, td = env.step_and_maybe_reset(td)
        for row, copy in enumerate(bare):
            actions = dict(zip(copy.possible_agents, before[row].tolist(), strict=True))
            seen[row], reward, _, truncated, _ = copy.step(actions)
            actual = stepped["next", keys.REWARD][row, :, 0]
            assert (
                actual.tolist() == torch.tensor(list(reward.values()), dtype=torch.float32).tolist()
            )
            ends = bool(stepped["next", keys.DONE][row])
            assert ends == any(truncated.values()) == (step % 7 == 6)
            assert not stepped["next", keys.TERMINATED][row]
            if ends:
                seen[row], _ = copy.reset(seed=int(env.base_env.episode_seeds[row]))


@pytest.mark.slow
def test_copies_reset_each_for_itself_and_each_alone_is_the_same(copies: dict[str, Any]) -> None:
    env = make_env(SPREAD)  # episodes of 3, 4 and 5 steps
    played = env.rollout(12, break_when_any_done=False)
    assert [played["next", keys.DONE][row].sum() for row in range(3)] == [4, 3, 2]
    steps = played[keys.OBSERVATION][..., 0, 1]
    assert steps[1].tolist() == [0, 1, 2, 3] * 3
    assert len(played[keys.OBSERVATION][..., 0, 0].unique()) == 4 + 3 + 3  # an own seed each
    copies["end"] = 4
    cfg = compose_config(SPREAD)
    alone = build.make_env(cfg, num_envs=1, first_env=1).rollout(12, break_when_any_done=False)
    assert (alone[keys.OBSERVATION] == played[keys.OBSERVATION][1:2]).all()


@pytest.mark.slow
def test_agents_are_paid_in_the_tasks_order(copies: dict[str, Any]) -> None:
    env = make_env([*SPREAD, "reward=team"])
    td = env.reset()
    td[keys.ACTION] = torch.tensor([[0, 1], [2, 3], [4, 4]])
    later = env.step(td)["next"]
    assert later[keys.OWN_REWARD][..., 0].tolist() == [[0, 11], [2, 13], [4, 14]]
    assert later[keys.REWARD][..., 0].tolist() == [[11, 11], [15, 15], [18, 18]]


@pytest.mark.slow
@pytest.mark.parametrize("action", [-1, 5])
def test_an_invalid_action_is_one_line(copies: dict[str, Any], action: int) -> None:
    env = make_env(SPREAD)
    td = env.reset()
    td[keys.ACTION] = torch.tensor([[0, 1], [2, action], [4, 4]])
    with pytest.raises(BadInput, match=f"^action {action}: valid: 0 to 4$"):
        env.step(td)


@pytest.mark.slow
@pytest.mark.parametrize("terminates", [True, False])
def test_an_episode_ends_for_all_when_it_ends_for_one(
    copies: dict[str, Any], terminates: bool
) -> None:
    copies |= {"terminates": terminates}
    ends = make_env(SPREAD).rollout(3)["next"]
    assert ends[keys.DONE][0].flatten().tolist() == [False, False, True]
    assert ends[keys.TERMINATED][0, -1] == terminates
    assert ends[keys.TRUNCATED][0, -1] != terminates


@pytest.mark.slow
def test_the_seed_decides_all() -> None:
    first, again, other = (make_env([*SPREAD, f"seed={seed}"]).reset() for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first[keys.OBSERVATION] != other[keys.OBSERVATION]).any()


@pytest.mark.slow
@pytest.mark.parametrize(("topology", "live"), [("full", True), ("none", False)])
def test_contact_is_fixed_and_the_others_are_ranked_in_order(topology: str, live: bool) -> None:
    td = make_env([*SPREAD, f"topology={topology}"]).rollout(2)
    others = ~torch.eye(3, dtype=torch.bool)
    for moment in (td, td["next"]):
        assert (moment[keys.ADJACENCY] == (others & live)).all()
        assert (moment[keys.DISTANCE_RANK] == torch.tensor([[0, 1, 2], [1, 0, 2], [1, 2, 0]])).all()


@family(
    ("overrides", "words"),
    [
        *[([f"topology={level}"], "valid: full, none") for level in ("view", "radius", "sight")],
        (["encoder=cnn"], "gives a vector; valid: mlp"),
        (["agent.augment=true"], "agent.augment=true"),
        (["env.task=mpe2.simple_adversary_v3"], "the same size for all"),
        (["env.task=mpe2.nothing_v3"], "mpe2 has no such task"),
        (["env.task=pettingzoo.classic.rps_v2"], "must be a Box"),
        (["env.task=pettingzoo.sisl.nothing_v1"], "nothing"),
        (["env.options={continuous_actions: true}"], "must be a Discrete"),
        (["env.options={M: 1}"], "'M'"),
    ],
    fast=3,
)
def test_what_does_not_fit_is_one_line(overrides: list[str], words: str) -> None:
    cfg = compose_config([*SPREAD, *overrides])
    with pytest.raises(BadInput, match=words) as caught:
        build.make_agent(cfg, build.make_env(cfg))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "task",
    [
        "os.path", "mpe2", "mpe2.all_modules", "mpe2x.simple_v3", "pettingzoo.test.api_test",
        "pettingzoo.utils.env_v3.x_v1", "pettingzoo.sisl.pursuit", "mpe2.simple_v3\n",
        "mpe2..simple_v3", "marl_clean.pettingzoo_v0", "pettingzoo.pursuit_v5", "",
    ],
)  # fmt: skip
def test_nothing_but_tasks_is_imported(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pettingzoo.importlib, "import_module", None)
    with pytest.raises(BadInput, match="env.task"):
        pettingzoo.wrapped(task, {})
    assert schema.mismatch(task, pettingzoo.Task)


@pytest.mark.parametrize("value", ["abc", "[1]", "{x: 1}", "null"])
def test_options_are_numbers_and_flags(value: str) -> None:
    with pytest.raises(BadInput, match="env.options"):
        compose_config([*SPREAD, f"env.options={{render_mode: {value}}}"])


@pytest.mark.parametrize(
    "kinds",
    [
        {"does": [Discrete(5), Discrete(4)]},
        {"does": [Discrete(5, start=1)] * 2},
        {"seen": [Box(0, 1, (2,)), Box(0, 1, (3,))]},
        {"late": 1},
    ],
)
def test_agents_must_be_alike(copies: dict[str, Any], kinds: dict[str, Any]) -> None:
    copies |= kinds
    with pytest.raises(BadInput, match="env.task"):
        make_env(SPREAD)


@pytest.mark.slow
def test_a_return_is_the_sum_over_one_episode_and_all_agents(copies: dict[str, Any]) -> None:
    env = make_env(SPREAD)

    class Threes(nn.Module):
        def forward(self, td: Any) -> Any:
            return td.set(keys.ACTION, torch.full((3, 2), 3))

    records = run_episodes(env, Threes(), 0.0, seed=7)
    assert [record["steps"] for record in records] == [3, 4, 5]
    assert [record["return"] for record in records] == [16 * 3, 16 * 4, 16 * 5]
    env.set_seed(7)
    env.reset()
    assert [record["seed"] for record in records] == env.base_env.episode_seeds.tolist()
    noisy = [run_episodes(env, Threes(), 0.5, seed=7) for _ in range(2)]
    assert noisy[0] == noisy[1] != records
    assert run_episodes(env, None, 1.0, seed=7) == run_episodes(env, Threes(), 1.0, seed=7)


def train(folder: Path, *overrides: str) -> list[dict[str, Any]]:
    cfg = compose_config([*SPREAD, "env.num_envs=6", *SHORT, f"name={folder.name}", *overrides])
    return command.main(cfg, folder, Console(quiet=True))


@pytest.mark.long
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("comm", ["plan", "none"])
def test_a_run_trains_measures_and_draws(tmp_path: Path, comm: str) -> None:
    folder = tmp_path / "mine"
    entries = train(folder, f"comm={comm}")
    names = {path.name for path in folder.iterdir()}
    assert names >= {"config.yaml", "metrics.csv", "checkpoints", "evaluation.json", "curve.png"}
    assert "replay.gif" not in names
    rows = list(csv.DictReader((folder / "metrics.csv").read_text().splitlines()))
    assert int(rows[-1]["updates"]) > 10
    losses = [float(row["loss"]) for row in rows if row["loss"]]
    assert losses and all(map(math.isfinite, losses))
    assert [row["frames"] for row in rows if row["validation/return"]] == ["576", "1056"]
    assert entries == json.loads((folder / "evaluation.json").read_text())
    assert [entry["policy"] for entry in entries] == ["mine", "random"]
    ours, random = ([house["seed"] for house in entry["houses"]] for entry in entries)
    assert ours == random and len(set(ours)) == 4
    assert train(folder, f"comm={comm}") == entries  # finished: nothing is done again
    again = load_policy(folder)(make_env([*SPREAD, *SHORT]).reset())
    assert again[keys.ACTION_VALUE].shape == (3, 3, 5)
    table = Console(record=True, width=100, quiet=True)
    assert compare.main([str(folder)], console=table) == entries


@pytest.mark.long
def test_a_resumed_run_begins_new_episodes(
    tmp_path: Path,
    copies: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    copies["end"] = 10
    begun: list[int] = []
    reset = Count.reset

    def noting(self: Count, seed: int | None = None, options: Any = None) -> Any:
        begun.extend([seed] if seed else [])  # TorchRL's wrapper and ours look once without
        return reset(self, seed)

    class Killed(BaseException):
        """Ends a run without a chance to save."""

    def dying(cfg: Any, policy: Any) -> Any:
        raise Killed

    monkeypatch.setattr(Count, "reset", noting)
    short = ["trainer.checkpoint_interval_frames=240", "trainer.eval_interval_frames=480"]
    short += ["trainer.frames_per_batch=240", "trainer.total_frames=720"]
    with monkeypatch.context() as patch:
        patch.setattr(command, "validate", dying)
        with pytest.raises(Killed):
            train(tmp_path / "mine", *short)
    first = begun.copy()
    assert len(first) == len(set(first)) == 6 * (1 + 480 // 6 // 10)
    begun.clear()
    train(tmp_path / "mine", *short)
    assert "resumes with new episodes" in caplog.text
    # All copies begin when they are made; at frame 240, saved, each was in its fifth episode.
    assert begun[:6] == first[:6]
    assert begun[6:12] == first[6 * 5 : 6 * 6]


@family(
    ("arguments", "words"),
    [
        (["watch"], "no houses"),
        (["figure", "houses"], "no houses"),
        (["benchmark"], "no houses"),
        (["evaluate"], "planners need houses"),
        (["train", "topology=view"], "topology=view"),
        (["train", "env.task=os.path"], "env.task: must name a task"),
        (["train", "env.n_agents=4"], "env.n_agents: no such key"),
    ],
    fast=2,
)
def test_commands_refuse_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    name, *settings = arguments
    assert cli.main([name, *settings[:1], "experiment=spread", *settings[1:]]) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert words in err and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
