"""What the cleaning env returns from resets and steps, as TensorDicts."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from marl_clean import keys
from marl_clean.env.specs import REWARD_TERMS, terms_of
from marl_clean.world.dynamics import Outcome
from marl_clean.world.patches import Heard
from marl_clean.world.rules import Rules
from marl_clean.world.state import State
from marl_clean.world.step import Settled


def first_frame(state: State, rules: Rules, told: Composite) -> TensorDict:
    """Return the frame of a reset, in which nothing is earned, nothing ended, nothing said.

    `told`: the spec of what a policy may say to the env.
    """
    zero = torch.zeros((len(state.step), 1), dtype=torch.bool, device=state.step.device)
    endings = {key: zero.clone() for key in keys.ENDINGS}
    nothing = torch.zeros((*state.position.shape[:2], 1), device=state.position.device)
    info = _of_robots(state, {name: nothing.clone() for name in terms_of(rules)})
    robots = {"position": state.position, "own_reward": nothing, "info": info}
    frame = _of_worlds(state, robots, endings)
    return frame if told.is_empty() else frame.update(told.zero())


def next_frame(state: State, outcome: Outcome, settled: Settled) -> TensorDict:
    """Return the frame after a step: positions, what each robot earned and why, what ended.

    A robot is paid what it earned unless a reward split says otherwise.
    """
    terms = (outcome.step_term, outcome.cleaning_term, outcome.discovery_term)
    named = dict(zip(REWARD_TERMS, terms, strict=True))
    for name, term in (("collision", outcome.collision_term), ("spill", outcome.spill_term)):
        if term is not None:
            named[name] = term
    info = _of_robots(state, named)
    own = outcome.own_reward
    robots = {"position": state.position, "own_reward": own, "info": info}
    robots["reward"] = own.clone() if settled.reward is None else settled.reward
    roots = {key: getattr(settled, key) for key in keys.ENDINGS}
    for key, value in settled.entries.items():
        if isinstance(key, str):
            roots[key] = value
        else:
            robots[key[1]] = value
    return _of_worlds(state, robots, roots)


def heard_in(frame: TensorDictBase) -> Heard | None:
    """Return what a policy wrote that robots read in messages; None: it wrote nothing."""
    told = [frame.get(key, None) for key in (keys.TOLD_PATCH, keys.TOLD_EDGES, keys.TOLD_PLACE)]
    return None if any(entry is None for entry in told) else Heard(*told)


def _of_worlds(state: State, robots: dict, roots: dict[str, Tensor]) -> TensorDict:
    entries = {keys.AGENTS: _of_robots(state, robots), **roots}
    return TensorDict(entries, state.step.shape, device=state.step.device)


def _of_robots(state: State, entries: dict) -> TensorDict:
    return TensorDict(entries, state.position.shape[:2], device=state.position.device)
