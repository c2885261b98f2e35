"""A step of the worlds and a beginning of some, each as one function: what an env compiles.

Each is one call because a call of compiled code costs as much as it computes for a thousand
worlds. What is observed may be computed along with it. In one function a matrix is written once:
compiled code that writes it twice copies it for the second time.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.settings import Memory, Sensor
from marl_clean.world.dynamics import Outcome, advance_, episode_ends, note_robots_, touch_
from marl_clean.world.episode import begin
from marl_clean.world.exchange import Exchange, exchange_
from marl_clean.world.lending import Lending, lend_
from marl_clean.world.patches import Heard, Patches, hear_, see_by_heard_, tell_own_
from marl_clean.world.setup import Setup
from marl_clean.world.shared_map import merge_maps
from marl_clean.world.state import State

Pay = Callable[
    [Float[Tensor, "env agent 1"], Bool[Tensor, "env agent agent"]], Float[Tensor, "env agent 1"]
]
"""What each robot is paid, from what all earned and the contacts before the step."""
Entries = dict[str | tuple[str, str], Tensor]
"""What is observed, by its keys."""
Read = Callable[[State, Setup], Entries]
"""An observation as a pure function of the worlds."""


class Along(NamedTuple):
    """What is computed along with a step."""

    reads: Sequence[Read] = ()
    pay: Pay | None = None
    adjacency: Bool[Tensor, "env agent agent"] | None = None  # before the step, for `pay`


NOTHING = Along()


class Settled(NamedTuple):
    """How the worlds stand after a step."""

    done: Bool[Tensor, "env 1"]
    terminated: Bool[Tensor, "env 1"]
    truncated: Bool[Tensor, "env 1"]
    reward: Float[Tensor, "env agent 1"] | None  # None without `pay`
    entries: Entries


def step_(
    state: State,
    action: Int[Tensor, "env agent"],
    moves: Int[Tensor, "4 2"],
    setup: Setup,
    unnoticed: Bool[Tensor, "env agent"] | None,
    along: Along,
) -> tuple[Outcome, Settled]:
    """Advance the worlds a step, in place, where robots write their own cells and bumps alone."""
    outcome = advance_(state, action, moves, setup.rules, unnoticed)
    return outcome, settle_(state, outcome, setup, along)


def tell_(state: State, setup: Setup, heard: Heard | None) -> None:
    """Let robots hear each other's patches, in place, before anyone moves.

    `heard`: a policy's, where patches are coded; None tells nothing.
    """
    if not isinstance(setup.exchange, Patches):
        return
    if not setup.exchange.coded and setup.contact is not None:
        contact = setup.contact(state, setup.rules)
        tell_own_(state, contact, setup.exchange.tells, setup.rules.margin)
    elif heard is not None:
        hear_(state, heard, setup.rules.margin)


def settle_(state: State, outcome: Outcome, setup: Setup, along: Along) -> Settled:
    """Do what follows once everything has moved: touch, meet, end, be paid, be observed."""
    if setup.rules.sensor is Sensor.TOUCH4:
        touch_(state, setup.rules)
    meet_(state, setup)
    terminated, truncated = episode_ends(state, setup.rules.stuck_after)
    reward = None
    if along.pay is not None and along.adjacency is not None:
        reward = along.pay(outcome.own_reward, along.adjacency)
    return Settled(
        done=(terminated | truncated)[:, None],
        terminated=terminated[:, None],
        truncated=truncated[:, None],
        reward=reward,
        entries=_entries(state, setup, along.reads),
    )


def begin_rows_(
    state: State,
    setup: Setup,
    rows: Int[Tensor, " row"],
    episode: Int[Tensor, " row"],
    reads: Sequence[Read],
) -> tuple[State, Entries]:
    """Begin the given episodes in the worlds `rows`, in place.

    Returns these worlds alone, and what `reads` observe in them.
    """
    setup = setup.of_rows(rows)
    fresh = begin(setup, episode)
    meet_(fresh, setup)
    entries = _entries(fresh, setup, reads)
    state.write_rows_(rows, fresh)
    return fresh, entries


def meet_(state: State, setup: Setup) -> None:
    """Let maps take in what robots in contact know, before anyone observes."""
    if setup.contact is None:
        return
    if setup.rules.memory is Memory.MERGED:
        state.record = merge_maps(state.record, setup.contact(state, setup.rules))
    if isinstance(setup.exchange, Exchange):
        exchange_(state, setup.contact(state, setup.rules), setup.exchange, setup.rules)
    elif isinstance(setup.exchange, Patches):
        see_by_heard_(state)
    elif isinstance(setup.exchange, Lending):
        lend_(state, setup.contact(state, setup.rules))
    if setup.rules.robots_noted:  # last: others are told of them with the next step
        note_robots_(state, setup.contact(state, setup.rules), setup.rules)


def _entries(state: State, setup: Setup, reads: Sequence[Read]) -> Entries:
    return {key: value for read in reads for key, value in read(state, setup).items()}
