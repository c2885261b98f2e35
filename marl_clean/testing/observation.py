"""What every observation must hold."""

from typing import Any

import torch
from torch import Tensor
from torchrl.envs import TransformedEnv, check_env_specs

from marl_clean import keys
from marl_clean.house.base import Houses
from marl_clean.settings import Form
from marl_clean.testing._broken import Clause, require, require_close, require_equal, verify
from marl_clean.testing._levels import Level, Maker, maker
from marl_clean.testing._worlds import N_AGENTS, drawn_actions, lane, make_worlds

MEMORIES = ("shared", "private", "merged")
HARD = ("env.stuck_after=4", "env.bump_noise=0.3")


def check_observation(level: Level, **settings: Any) -> None:
    """An observation shows each robot a tensor within its spec, the same alone as among many.

        >>> check_observation("crop", view_size=5)

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    made = maker("observation", level, settings)
    verify(made.label, CLAUSES, made)


def worlds_seen_by(
    make: Maker, *settings: str, houses: Houses | None = None, **place: Any
) -> TransformedEnv:
    """Return worlds observed by a new object of the level."""
    observation = make()
    return make_worlds(
        [observation], houses, settings=settings, reach_cells=observation.reach_cells, **place
    )


def seen_while_stepping(env: TransformedEnv, actions: Tensor) -> Tensor:
    """Return what robots see after each step, `[step, env, agent, ...]`; resets included."""
    td, seen = env.reset(), []
    for action in actions:
        td[keys.ACTION] = action
        step, td = env.step_and_maybe_reset(td)
        seen += [step["next", keys.OBSERVATION].clone(), td[keys.OBSERVATION].clone()]
    return torch.stack(seen)


def it_gives_the_form_that_it_declares(make: Maker) -> None:
    """A robot sees `shape()` numbers in float32: squares [channel, K, K], or a vector [d]."""
    observation = make()
    gives, shape = observation.gives, tuple(observation.shape())
    require(isinstance(gives, Form), f"gives is {gives!r}, not a Form")
    ranks = {Form.SQUARES: 3, Form.VECTOR: 1}
    require(len(shape) == ranks[gives], f"gives {gives.value}, but shape() is {shape}")
    if gives is Form.SQUARES:
        require(shape[-1] == shape[-2], f"gives {gives.value}, but shape() is {shape}")
    seen = worlds_seen_by(make).reset()[keys.OBSERVATION]
    require(seen.dtype == torch.float32, f"the observation is {seen.dtype}, not float32")
    whole = (6, N_AGENTS, *shape)
    require(seen.shape == whole, f"the observation is {list(seen.shape)}, not {list(whole)}")


def values_are_within_the_spec(make: Maker) -> None:
    """Values are finite and between `lowest` and 1, under every `env.memory`."""
    for memory in MEMORIES:
        settings = (f"env.memory={memory}", "env.sensor=touch4", "env.bump_noise=0.2")
        env = worlds_seen_by(make, *settings)
        check_env_specs(env, check_dtype=True)
        spec = env.observation_spec[keys.OBSERVATION]
        rollout = env.rollout(20, break_when_any_done=False)
        for part in (rollout, rollout["next"]):
            seen = part[keys.OBSERVATION]
            inside = all(spec.is_in(seen[:, step]) for step in range(20))
            least, greatest = seen.min().item(), seen.max().item()
            require(inside, f"leaves its spec with env.memory={memory}: {least} to {greatest}")


def a_lane_of_one_row_is_a_house(make: Maker) -> None:
    """Houses of a single row can be observed."""
    seen = worlds_seen_by(make, houses=lane(), num_envs=2).rollout(8)["next", keys.OBSERVATION]
    require(seen.isfinite(), "the observation in a house of one row is not finite")


def a_world_of_many_sees_what_it_sees_alone(make: Maker) -> None:
    """A world shows what it shows alone, across episodes: nothing crosses between worlds."""
    actions = drawn_actions(24, 4)
    for memory in MEMORIES:
        settings = (f"env.memory={memory}", *HARD)
        together = seen_while_stepping(worlds_seen_by(make, *settings, num_envs=4), actions)
        for world in (0, 2):
            single = worlds_seen_by(make, *settings, num_envs=1, first_env=world)
            alone = seen_while_stepping(single, actions[:, world : world + 1])
            broken = f"world {world} of 4 shows something else alone, env.memory={memory}"
            require_close(together[:, world], alone[:, 0], broken, tolerance=1e-6)


def a_partial_reset_shows_what_a_whole_one_does(make: Maker) -> None:
    """Worlds that are reset among others show what they show when all are reset."""
    env, other = (worlds_seen_by(make, "env.memory=private", num_envs=5) for _ in range(2))
    actions = drawn_actions(6, 5)
    seen_while_stepping(env, actions)
    last = env.step(env.rand_action(env.reset()))["next"]
    last = last.select(keys.AGENTS, *keys.ENDINGS)
    before = last[keys.OBSERVATION].clone()
    begins = torch.tensor([False, True, False, False, True])
    last["_reset"] = begins[:, None]
    after = env.reset(last)[keys.OBSERVATION]
    other.base_env.load_state_dict(env.base_env.state_dict())
    episodes = other.base_env.state.episode
    other.base_env.state.episode = torch.where(begins, episodes - 1, episodes)
    whole = other.reset()[keys.OBSERVATION]
    for world in (1, 4):
        broken = f"world {world}, reset among others, shows something else than when all are reset"
        require_close(after[world], whole[world], broken, tolerance=1e-6)
    for world in (0, 2, 3):
        broken = f"world {world} was not reset but shows something else"
        require_equal(after[world], before[world], broken)


def both_step_methods_show_the_same(make: Maker) -> None:
    """TorchRL's own step method shows the same, to the bit."""
    actions = drawn_actions(16, 6)
    ours, torchrls = (
        seen_while_stepping(worlds_seen_by(make, *HARD, torchrl=torchrl), actions)
        for torchrl in (False, True)
    )
    require_equal(ours, torchrls, "the env's step and TorchRL's show different things")


def observing_changes_nothing(make: Maker) -> None:
    """The worlds' dynamics do not depend on whether they are observed."""
    actions = drawn_actions(16, 6)
    states = []
    reach = make().reach_cells
    for transforms in ([make()], []):
        env = make_worlds(transforms, settings=HARD, reach_cells=reach)
        td = env.reset()
        for action in actions:
            td[keys.ACTION] = action
            _, td = env.step_and_maybe_reset(td)
        states.append(env.base_env.state.tensors())
    for name, value in states[0].items():
        require_equal(value, states[1][name], f"observing changes the worlds' {name}")


CLAUSES: tuple[Clause, ...] = (
    it_gives_the_form_that_it_declares,
    values_are_within_the_spec,
    a_lane_of_one_row_is_a_house,
    a_world_of_many_sees_what_it_sees_alone,
    a_partial_reset_shows_what_a_whole_one_does,
    both_step_methods_show_the_same,
    observing_changes_nothing,
)
