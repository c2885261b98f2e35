"""The TorchRL specs of a `CleaningEnv`."""

import torch
from torchrl.data import Binary, Bounded, Categorical, Composite, TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.world.dynamics import MOVES
from marl_clean.world.patches import CLEANED, SIDE, UNKNOWN
from marl_clean.world.rules import Rules

REWARD_TERMS = ("step", "cleaning", "discovery")


def terms_of(rules: Rules) -> tuple[str, ...]:
    """Return the names of the terms of `own_reward`; further ones only where they pay."""
    collision = ("collision",) if rules.collision_pays else ()
    spill = ("spill",) if rules.spills.per_episode else ()
    return (*REWARD_TERMS, *collision, *spill)


def told_specs(num_envs: int, n_agents: int, largest_side: int) -> Composite:
    """Return the spec of what a policy hands over that robots read in messages: patches, edges."""
    robots = torch.Size([num_envs, n_agents])
    edges, places = torch.Size([*robots, n_agents]), torch.Size([*robots, 2])
    told = {
        keys.TOLD_PATCH[1]: Bounded(
            UNKNOWN, CLEANED, torch.Size([*robots, SIDE**2]), dtype=torch.int8
        ),
        keys.TOLD_EDGES[1]: Binary(n_agents, edges, dtype=torch.bool),
        keys.TOLD_PLACE[1]: Bounded(0, largest_side, places, dtype=torch.int64),
    }
    return Composite(agents=Composite(told, shape=robots), shape=robots[:1])


def make_specs(
    num_envs: int, n_agents: int, largest_side: int, rules: Rules
) -> tuple[Composite, Composite, Composite, Composite]:
    """Return the specs of actions, observations, rewards and endings."""
    agents = torch.Size([num_envs, n_agents])
    scalar = torch.Size([*agents, 1])

    def of_agents(**specs: TensorSpec) -> Composite:
        return Composite(agents=Composite(**specs, shape=agents), shape=agents[:1])

    places = torch.Size([*agents, 2])
    terms = Composite({name: Unbounded(scalar) for name in terms_of(rules)}, shape=agents)
    flag = Binary(1, torch.Size([num_envs, 1]), dtype=torch.bool)
    return (
        of_agents(action=Categorical(len(MOVES), shape=agents)),
        of_agents(
            position=Bounded(0, largest_side, shape=places, dtype=torch.int64),
            own_reward=Unbounded(scalar),
            info=terms,
        ),
        of_agents(reward=Unbounded(scalar)),
        Composite({name: flag.clone() for name in keys.ENDINGS}, shape=agents[:1]),
    )
