"""From a config to live objects: the one place where the rooms are put together."""

from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.envs import Compose, InitTracker, RewardSum, Transform, TransformedEnv

from marl_clean import keys
from marl_clean.channel.base import Channel, Dims
from marl_clean.comm.base import Comm
from marl_clean.config.class_source import constant, takes
from marl_clean.config.compose import checked, has_houses
from marl_clean.config.fitting import check_fit
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import find_run, load_config
from marl_clean.encoder.base import Encoder
from marl_clean.env.action_mask import KnownWalls
from marl_clean.env.channel_seed import ChannelSeed
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.for_schemes import asked_of_env, exchange_of, reach_cells
from marl_clean.env.global_state import GlobalState
from marl_clean.env.shaping import Potential, Shaping
from marl_clean.env.transformed import TransformedWorlds
from marl_clean.errors import BadInput
from marl_clean.house.base import Houses, draw_bank, draw_houses, smallest_first, split_seeds
from marl_clean.learning.agent import Agent
from marl_clean.learning.width import as_wide_as_allowed, fewest_weights
from marl_clean.planner.base import Planner
from marl_clean.settings import HouseOrder
from marl_clean.storage.checkpoint import fit_weights, load_weights
from marl_clean.storage.manifest import count_weights, weights_sha256

ACTING_KEYS = ("mask_walls", "play")
"""Settings of learners that change how actions are chosen, not the network."""


def training_houses(cfg: DictConfig) -> Houses:
    """Draw the distinct houses of training episodes, for a curriculum the smallest first."""
    houses = draw_bank(instantiate(cfg.house), cfg.train_houses, cfg.env.n_agents)
    return smallest_first(houses) if cfg.trainer.get("curriculum_stages", 1) > 1 else houses


def held_out_houses(cfg: DictConfig, split: str, count: int) -> Houses:
    """Draw the first `count` houses of the validation or test split; a plan is one house."""
    return draw_houses(instantiate(cfg.house), split_seeds(split, count), cfg.env.n_agents)


def make_env(
    cfg: DictConfig,
    houses: Houses | None = None,
    *,
    num_envs: int | None = None,
    house_order: HouseOrder = HouseOrder.RANDOM,
    never_stuck: bool = False,
    first_env: int = 0,
    seeded: bool = False,
    shaped: bool = True,
) -> TransformedEnv:
    """Build the env with topology, observation and reward; for an external task see `make_task`.

    Args:
        cfg: a composed config.
        houses: the houses of the episodes; null: the training houses.
        num_envs: instead of `cfg.env.num_envs`.
        house_order: whether episodes draw their house, or env i always has house i.
        never_stuck: without truncation when nothing new is cleaned, as in evaluation.
        first_env: index of the first world; what is drawn in a world depends on its index.
        seeded: frames hold draws for channels, whether or not the config's channel draws.
        shaped: robots are paid for `env.shaping`, and frames hold what messages are grounded in;
            evaluation goes without.
    """
    if not has_houses(cfg):
        return make_task(cfg, num_envs, first_env)
    topology = instantiate(cfg.topology)
    observation = instantiate(cfg.observation)
    exchanges = constant(cfg.comm._target_, "exchanges")
    changes: dict = {"stuck_after": None} if never_stuck else {}
    if num_envs is not None:
        changes["num_envs"] = num_envs
    env = instantiate(
        cfg.env,
        houses=training_houses(cfg) if houses is None else houses,
        margin=max(1, observation.reach_cells, reach_cells(cfg.comm, exchanges)),
        house_order=house_order,
        contact=topology.contact,
        exchange=exchange_of(cfg.comm, exchanges),
        first_env=first_env,
        seed=cfg.seed,
        device=torch.device(cfg.device),
        **changes,
    )
    further: list[Transform] = []
    if needs_state(cfg):
        further.append(GlobalState())
    if cfg.agent.get("mask_walls", False):
        further.append(KnownWalls())
    further += asked_of_env(cfg.comm, constant(cfg.comm._target_, "reads"), learning=shaped)
    weight = env.rules.shaping if shaped else 0.0
    if weight:
        further.append(Potential())
    transforms = (topology, observation, *further, *draws(cfg, seeded), *payment(cfg, weight))
    return TransformedWorlds(env, Compose(*transforms))


def make_task(cfg: DictConfig, num_envs: int | None = None, first_env: int = 0) -> TransformedEnv:
    """Build an env without houses and its reward; it defines its own observation.

    Raises:
        BadInput: the topology needs positions.
    """
    changes = {} if num_envs is None else {"num_envs": num_envs}
    env = instantiate(
        cfg.env,
        among=instantiate(cfg.topology).among,
        first_env=first_env,
        seed=cfg.seed,
        device=torch.device(cfg.device),
        **changes,
    )
    return TransformedEnv(env, Compose(*draws(cfg), *payment(cfg)))


def draws(cfg: DictConfig, seeded: bool = False) -> list[Transform]:
    """Build the transform that draws for channel and policy, where either draws or `seeded`."""
    sampled = cfg.agent.get("play") == "sampled"
    drawing = seeded or sampled or any(channel.draws for channel in make_channels(cfg, ()).values())
    return [ChannelSeed()] if drawing else []


def needs_state(cfg: DictConfig) -> bool:
    """Whether the learner uses the true state, in learning alone."""
    return bool(constant(cfg.agent._target_, "needs_state")) or cfg.agent.get("critic") == "state"


def payment(cfg: DictConfig, shaping: float = 0.0) -> list[Transform]:
    """Build what turns own rewards into what the robots are paid, and sums it up.

    `shaping`: the weight of what shaping adds before the split; its discount is the learner's.
    """
    split = instantiate(cfg.reward)
    pays = Shaping(split, shaping, cfg.agent.gamma) if shaping else split
    total = RewardSum(in_keys=[keys.REWARD], out_keys=[keys.EPISODE_REWARD])
    return [pays, total]


def make_planner(cfg: DictConfig, env: TransformedEnv) -> Planner:
    """Build the scripted policy and bind it to the env that it plans for."""
    planner = instantiate(cfg.planner)
    assert isinstance(planner, Planner) and isinstance(env.base_env, CleaningEnv)
    return planner.bind(env.base_env)


def make_encoder(cfg: DictConfig, seen: torch.Size) -> Encoder:
    """Build the encoder of what robots see, of shape `seen`.

    An encoder with a parameter `spread` receives how the observation's codes spread over planes.
    """
    parts = {}
    if has_houses(cfg) and takes(cfg.encoder._target_, "spread"):
        parts["spread"] = instantiate(cfg.observation).spread
    return instantiate(cfg.encoder, observation_shape=seen, **parts)


def make_comm(section: DictConfig, in_features: int, seen: torch.Size) -> Comm:
    """Build a scheme for features of this length; `seen` is the shape of an observation.

    A scheme that sends or reconstructs observations has a parameter `observed`, the number of
    values in one.
    """
    parts = {"observed": seen.numel()} if takes(section["_target_"], "observed") else {}
    return instantiate(section, in_features=in_features, **parts)


def make_channels(cfg: DictConfig, message_dims: Dims) -> dict[str, Channel]:
    """Build the stack of channels for messages of `message_dims` numbers, one entry a round."""
    stack = {}
    for name, section in cfg.channel.items():
        sized = takes(section["_target_"], "message_dims")
        parts = {"message_dims": message_dims} if sized else {}
        stack[str(name)] = instantiate(section, **parts)
    return stack


def make_agent(cfg: DictConfig, env: TransformedEnv) -> Agent:
    """Build encoder, communication and learner for what robots see in `env`.

    Weights are drawn from torch's global generator: seed it first.

    Raises:
        BadInput: the encoder does not take what robots see, or `parameter_budget` is too small.
    """
    check_fit(cfg)
    if cfg.get("parameter_budget") is not None:
        cfg = as_wide_as_allowed(cfg, lambda sized: _agent(sized, env).network)
    return _agent(cfg, env)


def _agent(cfg: DictConfig, env: TransformedEnv) -> Agent:
    return instantiate(cfg.agent, **agent_parts(cfg, env))


def check_size(cfg: DictConfig, env: TransformedEnv, folder: Path) -> None:
    """Hold the network of a run's config against the run's weights, before it is built.

    Raises:
        BadInput: the run has no whole weights, or fewer than encoder and scheme have.
    """
    seen = env.observation_spec[keys.OBSERVATION].shape[2:]

    def parts(sized: DictConfig) -> tuple[nn.Module, ...]:
        encoder = make_encoder(sized, seen)
        return encoder, make_comm(sized.comm, encoder.out_features, seen)

    needed, held = fewest_weights(cfg, parts), count_weights(folder)
    if held is None:
        load_weights(folder)  # which says why
    elif needed > held:
        raise BadInput(
            f"{folder}: its config needs {needed:,} weights or more, its checkpoint holds {held:,};"
            " same config needed"
        )


def agent_parts(cfg: DictConfig, env: TransformedEnv) -> dict[str, Any]:
    """Build what a learner needs besides its settings: parts of networks, and sizes of `env`."""
    seen = env.observation_spec[keys.OBSERVATION].shape[2:]
    encoder = make_encoder(cfg, seen)
    comm = make_comm(cfg.comm, encoder.out_features, seen)
    state: dict[str, Any] = {}
    if needs_state(cfg):
        state["state_shape"] = env.observation_spec[keys.STATE].shape[1:]
    return {
        **state,
        "encoder": encoder,
        "comm": comm,
        "channels": make_channels(cfg, tuple(comm.message_dims)),
        "n_agents": env.base_env.n_agents,
        "num_actions": env.full_action_spec[keys.ACTION].n,
        "device": cfg.device,
    }


def ready_for(agent: Agent, env: TransformedEnv) -> TransformedEnv:
    """Return the env with what the agent needs at resets: carried state at zero, and `is_init`."""
    primer = agent.primer()
    if primer is not None or agent.unrolls:
        env.append_transform(InitTracker())
    if primer is not None:
        env.append_transform(primer)
    return env


def ready_for_policy(cfg: DictConfig, env: TransformedEnv) -> TransformedEnv:
    """Return the env with what a policy of `cfg` carries from step to step."""
    with torch.random.fork_rng([]):  # the agent's weights are not used
        return ready_for(make_agent(cfg, env), env)


def start_from(agent: Agent, cfg: DictConfig) -> None:
    """Give an agent the weights that `cfg` says it starts from.

    Raises:
        BadInput: they do not fit its network, or are not those that `cfg` was composed for.
    """
    folder = find_run(cfg.checkpoint)
    if weights_sha256(folder) != cfg.weights:
        raise BadInput(f"checkpoint={cfg.checkpoint}: its weights have changed; start anew")
    fit_weights(agent.network, load_weights(folder, agent.network).tree, folder)
    agent.start_from_network()


def load_policy(folder: Path, wanted: DictConfig | None = None) -> TensorDictModuleBase:
    """Return the greedy policy of a run: the best weights on validation houses, else the last.

    It is on the CPU, wherever the run was trained.

    `wanted`: a config whose channel and whose `ACTING_KEYS` of the learner replace the run's.
    Weights of the training's channel do not transfer to another channel, which stays untrained.

    Raises:
        BadInput: the run has no whole weights yet, or they do not fit its config.
    """
    cfg = checked(load_config(folder))
    cfg.device = "cpu"
    houses = held_out_houses(cfg, "validation", 1) if has_houses(cfg) else None
    if wanted is not None:
        cfg.channel = wanted.channel
        for key in ACTING_KEYS:
            if key in cfg.agent and key in wanted.agent:
                cfg.agent[key] = wanted.agent[key]
    env = make_env(cfg, houses, num_envs=1)
    check_size(cfg, env, folder)
    agent = make_agent(cfg, env)
    fit_weights(agent.network, load_weights(folder, agent.network).tree, folder)
    return agent.policy()
