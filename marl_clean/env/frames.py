"""What the cleaning env tells of a moment, as TensorDicts."""

import torch
from tensordict import TensorDict
from torch import Tensor

from marl_clean import keys
from marl_clean.env.specs import REWARD_TERMS
from marl_clean.world.dynamics import Outcome
from marl_clean.world.state import State
from marl_clean.world.turn import Settled


def first_frame(state: State) -> TensorDict:
    """Return the frame of a reset, in which nothing has ended."""
    zero = torch.zeros((len(state.step), 1), dtype=torch.bool, device=state.step.device)
    endings = {key: zero.clone() for key in keys.ENDINGS}
    return _of_worlds(state, {"position": state.position}, endings)


def next_frame(state: State, outcome: Outcome, settled: Settled) -> TensorDict:
    """Return the frame after a step: places, what each robot earned and why, what ended.

    And what was computed along the way, all of it of the robots.
    """
    terms = (outcome.step_term, outcome.cleaning_term, outcome.discovery_term)
    info = _of_robots(state, dict(zip(REWARD_TERMS, terms, strict=True)))
    robots = {"position": state.position, "own_reward": outcome.own_reward, "info": info}
    robots |= {name: value for (_, name), value in settled.readings.items()}
    if settled.reward is not None:
        robots["reward"] = settled.reward
    return _of_worlds(state, robots, {key: getattr(settled, key) for key in keys.ENDINGS})


def _of_worlds(state: State, robots: dict, endings: dict[str, Tensor]) -> TensorDict:
    entries = {keys.AGENTS: _of_robots(state, robots), **endings}
    return TensorDict(entries, state.step.shape, device=state.step.device)


def _of_robots(state: State, entries: dict) -> TensorDict:
    return TensorDict(entries, state.position.shape[:2], device=state.position.device)
