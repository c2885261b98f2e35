"""What every scripted policy must hold."""

from typing import Any

import torch
from torch import Tensor
from torchrl.envs import TransformedEnv

from marl_clean import keys
from marl_clean.planner.base import Planner
from marl_clean.testing._broken import Clause, require, require_equal, verify
from marl_clean.testing._levels import Level, Maker, maker
from marl_clean.testing._worlds import N_AGENTS, make_worlds
from marl_clean.world.state import State

HIDDEN = {"blocked", "piece", "visited", "num_visited", "num_free", "furniture_moves", "house"}
"""The parts of the worlds' state that robots cannot know."""
FINISHED_UNDER = (
    ("env.sensor=bump",),
    ("env.sensor=touch4",),
    ("env.memory=private",),
    ("env.memory=merged",),
    ("env.knowledge=memorised",),
)


def check_planner(level: Level, *, finishes: bool = True, **settings: Any) -> None:
    """A planner acts validly, reads nothing that robots cannot know, and finishes every house.

        >>> check_planner("spiral")
        >>> check_planner("random", finishes=False)

    Args:
        level: its name, as on the command line, or its class.
        finishes: whether it is expected to clean every house completely.
        settings: of the level, instead of its yaml's.

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    made = maker("planner", level, settings)
    verify(made.label, (*CLAUSES, every_house_is_finished) if finishes else CLAUSES, made)


def planned(make: Maker, *settings: str, **place: Any) -> tuple[TransformedEnv, Planner]:
    """Return worlds and a planner for their robots."""
    env = make_worlds(settings=settings, **place)
    return env, make().bind(env.base_env)


def it_has_a_label(make: Maker) -> None:
    """The label, of tables and `evaluation.json`, is one short line."""
    label = make().label
    require(isinstance(label, str) and bool(label.strip()), f"label is {label!r}, not a string")
    require(len(label) < 80 and label.isprintable(), f"label is {label!r}, not one short line")


def actions_are_valid(make: Maker) -> None:
    """Every robot gets an action, int64 from 0 to 3."""
    env, planner = planned(make)
    action = planner(env.reset())[keys.ACTION]
    require(action.dtype == torch.int64, f"actions are {action.dtype}, not int64")
    require(action.shape == (6, N_AGENTS), f"actions are {list(action.shape)}, not [6, {N_AGENTS}]")
    least, greatest = int(action.min()), int(action.max())
    require(0 <= least <= greatest <= 3, f"actions from {least} to {greatest}; valid: 0 to 3")


def a_batch_equals_each_world_alone(make: Maker) -> None:
    """The actions in a world are those in this world alone, episode after episode."""

    def actions(num_envs: int, first_env: int) -> Tensor:
        place = {"num_envs": num_envs, "first_env": first_env}
        env, planner = planned(make, "env.max_steps=22", **place)  # a second episode begins
        return env.rollout(30, planner, break_when_any_done=False)[keys.ACTION]

    together = actions(3, 0)
    for world in range(3):
        broken = f"in world {world} of 3 ([step, robot]) it acts differently alone"
        require_equal(together[world], actions(1, world)[0], broken)


def the_truth_is_not_read(make: Maker) -> None:
    """The action stays the same when called twice, and with all that is hidden overwritten."""
    for sensor in ("bump", "touch4"):
        env, planner = planned(make, f"env.sensor={sensor}")
        base, td = env.base_env, env.reset()
        for step in range(25):
            action = planner(td)[keys.ACTION].clone()
            require_equal(
                planner(td)[keys.ACTION], action, f"differs when called twice in step {step}"
            )
            truth = base.state
            scrambled = {
                name: ~value if value.dtype == torch.bool else value + 1
                for name, value in truth.tensors().items()
                if name in HIDDEN
            }
            base.state = State(**{**truth.tensors(), **scrambled})
            blind = planner(td)[keys.ACTION].clone()
            base.state = truth
            broken = f"reads what no robot knows: step {step}, env.sensor={sensor}, [world, robot]"
            require_equal(blind, action, broken)
            td = env.step_mdp(env.step(td.set(keys.ACTION, action)))


def every_house_is_finished(make: Maker) -> None:
    """All free cells are cleaned before an episode is over, by one robot and by several."""
    for settings in FINISHED_UNDER:
        alone = () if settings[0].startswith("env.memory") else (1,)  # has all maps to itself
        for n_agents in (*alone, N_AGENTS):
            env, planner = planned(make, *settings, "env.stuck_after=null", n_agents=n_agents)
            finished, over = torch.zeros(2, *env.batch_size, dtype=torch.bool)
            td = env.reset()
            for _ in range(int(env.base_env.state.max_steps.max())):
                step, td = env.step_and_maybe_reset(planner(td))
                finished |= step["next", keys.TERMINATED].squeeze(-1) & ~over
                over |= step["next", keys.DONE].squeeze(-1)
                if over.all():
                    break
            left = (~finished).nonzero()[:, 0].tolist()
            robots = f"{n_agents} robots, {settings[0]}"
            require(finished, f"{robots}: houses {left} of 6 are not finished in 4 R C / n + 50")


CLAUSES: tuple[Clause, ...] = (
    it_has_a_label,
    actions_are_valid,
    a_batch_equals_each_world_alone,
    the_truth_is_not_read,
)
