"""What every learner must hold."""

import copy
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.global_state import GlobalState
from marl_clean.learning.agent import Agent
from marl_clean.settings import HouseOrder
from marl_clean.testing._broken import Clause, require, require_equal, verify
from marl_clean.testing._levels import Level, Maker, level_section, maker
from marl_clean.testing._worlds import N_AGENTS, scattered_houses

NUM_ENVS, STEPS = 4, 6
SMALL = (
    f"env.n_agents={N_AGENTS}",
    f"env.num_envs={NUM_ENVS}",
    "env.max_steps=5",
    "observation.view_size=9",
    "encoder.channels=[6,8]",
    "encoder.strides=[2,2]",
    "encoder.hidden=[24]",
)


SETTINGS_OF_THE_ENV = ("mask_walls", "critic", "play")
"""Settings of learners that add entries to the env's frames."""


class Learner(NamedTuple):
    """A level's maker for the contract, and the config of the scheme and the worlds around it."""

    make: Maker
    config: DictConfig


def check_agent(
    level: Level, *, comm: str | None = None, others: Sequence[str] = (), **settings: Any
) -> None:
    """A learner acts validly, learns from what it collected, and resumes from its state exactly.

        >>> check_agent("iql", comm="tarmac", precision="float32")

    It gets a small network and small worlds, and for each room that its class lists in `fits` the
    first level named there.

    Args:
        level: its name, as on the command line, or its class.
        comm: the scheme that it learns with; None: the first that fits.
        others: settings of other rooms, such as `encoder.memory=gru`.
        settings: of the level, instead of its yaml's.

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    make = maker("agent", level, settings)
    fits: dict[str, list[str]] = dict(make.constant("fits") or {})
    schemes = fits.pop("comm", ["plan"])
    scheme = schemes[0] if comm is None else comm
    levels = (f"{room}={names[0]}" for room, names in fits.items())
    config = _composed((*SMALL, *levels, *others)).copy()
    config.comm = level_section("comm", scheme)
    of_env = {key: value for key, value in settings.items() if key in SETTINGS_OF_THE_ENV}
    config.agent = OmegaConf.create({**config.agent, **of_env})
    verify(" ".join([make.label, f"comm={scheme}", *others]), CLAUSES, Learner(make, config))


@cache
def _composed(overrides: tuple[str, ...]) -> DictConfig:
    """Return a config, cached, since composing takes longer than all clauses."""
    return compose_config(overrides)


def started(learner: Learner) -> tuple[Agent, TransformedEnv]:
    """Return a learner, with weights drawn from seed 0, and its env."""
    env = build.make_env(
        learner.config, scattered_houses(), num_envs=NUM_ENVS, house_order=HouseOrder.FIXED
    )
    of_level = bool(learner.make.constant("needs_state"))
    needs_state = of_level or build.needs_state(learner.config)
    if needs_state and keys.STATE not in env.observation_spec.keys():
        env.append_transform(GlobalState())
    with torch.random.fork_rng([]):
        torch.manual_seed(0)
        parts = build.agent_parts(learner.config, env)
        if needs_state:
            parts["state_shape"] = env.observation_spec[keys.STATE].shape[1:]
        agent = learner.make(**parts)
    return agent, build.ready_for(agent, env)


def explored(agent: Agent, env: TransformedEnv, seed: int) -> TensorDictBase:
    """Return frames `[env, time]` as the learner collects them."""
    env.set_seed(seed)
    with torch.random.fork_rng([]), set_exploration_type(ExplorationType.RANDOM):
        torch.manual_seed(seed)
        policy = agent.exploration(env.full_action_spec)
        with torch.no_grad():
            return env.rollout(STEPS, policy, break_when_any_done=False).contiguous()


def batch_of(learner: Learner, agent: Agent, frames: TensorDictBase) -> TensorDictBase:
    """Return frames as the training loop passes them to `update`.

    Off policy these are windows of one step; on policy, what `estimate` makes of a block. They are
    consecutive where the learner unrolls, a flat batch where it does not.
    """
    block = frames.select(*agent.learns_from)
    fits: dict[str, Sequence[str]] = learner.make.constant("fits") or {}
    if "on_policy" in fits.get("trainer", ()):
        block = agent.estimate(block)
    else:
        block[keys.STEPS_TO_NEXT_OBS] = torch.ones(block.batch_size, dtype=torch.int64)
    return block if agent.unrolls else block.flatten()


def updated(agent: Agent, batch: TensorDictBase, seed: int) -> dict[str, Tensor]:
    """Make one update whose draws come from a seed."""
    with torch.random.fork_rng([]):
        torch.manual_seed(seed)
        return agent.update(batch.clone())


def weights_of(agent: Agent) -> dict[str, Tensor]:
    """Return copies of the network's weights."""
    return {name: weight.clone() for name, weight in agent.network.state_dict().items()}


def require_same_weights(agent: Agent, twin: Agent, broken: str) -> None:
    """Raise ContractBroken unless two networks have the same weights."""
    weights = twin.network.state_dict()
    for name, weight in agent.network.state_dict().items():
        require_equal(weight, weights[name], f"{broken}, in {name}")


def actions_are_valid(learner: Learner) -> None:
    """Each robot gets a valid action: greedy in evaluation, at times random in training."""
    agent, env = started(learner)
    td, frames = env.reset(), explored(agent, env, seed=1)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        first, again = (agent.policy()(td.clone())[keys.ACTION] for _ in range(2))
    for action, shape in ((first, [NUM_ENVS]), (frames[keys.ACTION], [NUM_ENVS, STEPS])):
        kind, wanted = f"{action.dtype} {list(action.shape)}", [*shape, N_AGENTS]
        require(kind == f"torch.int64 {wanted}", f"actions are {kind}, not int64 {wanted}")
        least, greatest = int(action.min()), int(action.max())
        require(0 <= least <= greatest <= 3, f"actions from {least} to {greatest}; valid: 0 to 3")
    require_equal(first, again, "the greedy policy acts differently on the same frame")
    alike = (frames[keys.ACTION] == frames[keys.ACTION][..., :1]).all()
    require(not alike, "exploring, all robots act alike in every step; each draws for itself")


def equal_frames_and_draws_give_equal_updates(learner: Learner) -> None:
    """An update moves the weights, has finite measures, and is repeated by the same draws."""
    (agent, env), (twin, _) = started(learner), started(learner)
    require_same_weights(agent, twin, "drawn from one seed, weights differ")
    batch = batch_of(learner, agent, explored(agent, env, seed=1))
    before = weights_of(agent)
    measures, others = updated(agent, batch, seed=4), updated(twin, batch, seed=4)
    require("loss" in measures, f"update measures {sorted(measures)}, but no loss")
    for name, value in measures.items():
        require(value.isfinite(), f"update measures {name} {value.tolist()}")
        require(not value.requires_grad, f"update measures {name} with its graph")
        require_equal(value, others[name], f"from the same frames, another {name}")
    require_same_weights(agent, twin, "from the same frames, other weights")
    after = agent.network.state_dict()
    moved = any(not torch.equal(before[name], after[name]) for name in before)
    require(moved, "an update moves no weight of the network")


def it_resumes_from_its_state(learner: Learner) -> None:
    """A learner that resumes from a state learns the same weights, to the bit."""
    (agent, env), (twin, _) = started(learner), started(learner)
    updated(agent, batch_of(learner, agent, explored(agent, env, seed=1)), seed=4)
    twin.load_state_dict(copy.deepcopy(agent.state_dict()))
    require_same_weights(agent, twin, "after loading its state, other weights")
    later = batch_of(learner, agent, explored(agent, env, seed=2))
    for resumed in (agent, twin):
        updated(resumed, later, seed=6)
    require_same_weights(agent, twin, "after an update from the same state, other weights")


def policies_follow_the_weights(learner: Learner) -> None:
    """A policy made before an update uses the weights after it."""
    agent, env = started(learner)
    early, td = agent.policy(), env.reset()
    frames = explored(agent, env, seed=1)
    for seed in range(3):
        updated(agent, batch_of(learner, agent, frames), seed)
    for weight in agent.network.parameters():
        torch.nn.init.normal_(weight.data, generator=torch.Generator().manual_seed(3))
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        first, late = (policy(td.clone())[keys.ACTION] for policy in (early, agent.policy()))
    require_equal(first, late, "a policy made before the weights changed acts by other weights")


def annealing_covers_the_whole_run(learner: Learner) -> None:
    """Exploration can be set at every point of a run, and what is logged of it are numbers."""
    agent, _ = started(learner)
    for progress in (0.0, 0.5, 1.0):
        agent.anneal(progress)
        for name, value in agent.measures().items():
            require(isinstance(value, float), f"measures() has {name}={value!r}, not a number")
    require(agent.history >= 0, f"history is {agent.history}")
    require((agent.history > 0) is agent.unrolls, "unrolls must be true exactly where history > 0")


CLAUSES: tuple[Clause, ...] = (
    actions_are_valid,
    equal_frames_and_draws_give_equal_updates,
    it_resumes_from_its_state,
    policies_follow_the_weights,
    annealing_covers_the_whole_run,
)
