"""A step of the worlds and a beginning of some, each as one function: what an env compiles.

Each is one call because a call of compiled code costs as much as it computes for a thousand
worlds. What is observed along with it comes as readers. In one function a matrix is written once:
compiled code that writes it twice copies it for the second time.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.settings import HouseOrder, Memory, Sensor
from marl_clean.world.dynamics import Outcome, advance_, episode_ends, touch_
from marl_clean.world.episode import FurnitureMoves, HouseTensors, begin
from marl_clean.world.random import Seed
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import merge_maps
from marl_clean.world.state import State

Contact = Callable[[State, Rules], Bool[Tensor, "env agent agent"]]
Pay = Callable[
    [Float[Tensor, "env agent 1"], Bool[Tensor, "env agent agent"]], Float[Tensor, "env agent 1"]
]
"""What each robot is paid, from what each earned and who was in contact before the step."""
Readings = dict[tuple[str, str], Tensor]
"""Entries of `agents` by their keys."""
Reader = Callable[[State, Rules], Readings]
"""A pure function of the worlds with short loops; see `Compiling.compiled`."""


class Along(NamedTuple):
    """What is computed along with a step."""

    readers: Sequence[Reader] = ()
    pay: Pay | None = None
    adjacency: Bool[Tensor, "env agent agent"] | None = None  # before the step, for `pay`


NOTHING = Along()


class Settled(NamedTuple):
    """How the worlds stand after a step."""

    done: Bool[Tensor, "env 1"]
    terminated: Bool[Tensor, "env 1"]
    truncated: Bool[Tensor, "env 1"]
    reward: Float[Tensor, "env agent 1"] | None  # None without `pay`
    readings: Readings


def step_(
    state: State,
    action: Int[Tensor, "env agent"],
    moves: Int[Tensor, "4 2"],
    rules: Rules,
    unnoticed: Bool[Tensor, "env agent"] | None,
    contact: Contact | None,
    along: Along,
) -> tuple[Outcome, Settled]:
    """Play one step in place, one in which only the robots' own cells and bumps are written."""
    outcome = advance_(state, action, moves, rules, unnoticed)
    return outcome, settle_(state, outcome, rules, contact, along)


def settle_(
    state: State, outcome: Outcome, rules: Rules, contact: Contact | None, along: Along
) -> Settled:
    """Do what follows once everything has moved: touch, meet, end, be paid, be read."""
    if rules.sensor is Sensor.TOUCH4:
        touch_(state, rules)
    _meet_(state, rules, contact)
    terminated, truncated = episode_ends(state, rules.stuck_after)
    reward = None
    if along.pay is not None and along.adjacency is not None:
        reward = along.pay(outcome.own_reward, along.adjacency)
    return Settled(
        done=(terminated | truncated)[:, None],
        terminated=terminated[:, None],
        truncated=truncated[:, None],
        reward=reward,
        readings=_readings(state, rules, along.readers),
    )


def begin_rows_(
    state: State,
    rows: Int[Tensor, " row"],
    later: bool,
    houses: HouseTensors,
    env_index: Int[Tensor, " env"],
    seed: Seed,
    order: HouseOrder,
    num_open: int,
    furniture: FurnitureMoves,
    rules: Rules,
    contact: Contact | None,
    readers: Sequence[Reader],
) -> tuple[State, Readings]:
    """Begin an episode in the worlds `rows`, in place: the next one (`later`) or this one anew.

    Returns these worlds alone, and what is read of them.
    """
    episode = state.episode[rows] + later
    fresh = begin(houses, env_index[rows], episode, seed, order, num_open, furniture, rules)
    _meet_(fresh, rules, contact)
    readings = _readings(fresh, rules, readers)
    state.write_rows_(rows, fresh)
    return fresh, readings


def _meet_(state: State, rules: Rules, contact: Contact | None) -> None:
    """Unite the maps of robots in contact, before anyone observes (`memory=merged`)."""
    if rules.memory is Memory.MERGED and contact is not None:
        state.record = merge_maps(state.record, contact(state, rules))


def _readings(state: State, rules: Rules, readers: Sequence[Reader]) -> Readings:
    return {key: value for reader in readers for key, value in reader(state, rules).items()}
