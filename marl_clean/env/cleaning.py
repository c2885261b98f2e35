"""The cleaning world as a TorchRL env."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np
import torch
from jaxtyping import Int, UInt8
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from marl_clean import keys
from marl_clean.env.checks import check_actions, check_rules
from marl_clean.env.compiling import Compiling
from marl_clean.env.frames import first_frame, heard_in, next_frame
from marl_clean.env.houses import house_tensors
from marl_clean.env.scene import scene_of
from marl_clean.env.specs import make_specs, told_specs
from marl_clean.env.viewer import Scene, draw
from marl_clean.errors import BadInput
from marl_clean.house.base import Houses
from marl_clean.settings import (
    HouseOrder,
    NonNegativeInt,
    PositiveInt,
    Sensor,
    Worlds,
)
from marl_clean.world import step
from marl_clean.world.dynamics import MOVES, advance_
from marl_clean.world.episode import begin
from marl_clean.world.furniture import move_furniture_
from marl_clean.world.noise import unnoticed_bumps
from marl_clean.world.patches import Heard, Patches
from marl_clean.world.random import Purpose, random_bits, seed_tensor, words_of_robots
from marl_clean.world.rules import Rules
from marl_clean.world.setup import Contact, FurnitureMoves, Setup, Telling
from marl_clean.world.spills import spill_
from marl_clean.world.state import State


@final
class CleaningEnv(Compiling):
    """Blind robots that clean unknown houses together, many houses at once.

    ## Description
    Each of `num_envs` worlds is a house of free and blocked cells with `n_agents` robots. The
    robots see nothing but the map they write themselves; they clean the cell they stand on.
    The rules are fixed in `marl_clean.world`; every reading of the paper is one of `Rules`.

    ## Actions
    `("agents", "action")`, int64 `[num_envs, n_agents]`: 0 up (row - 1), 1 right (col + 1),
    2 down (row + 1), 3 left (col - 1). There is no "stay".

    ## Observations
    `("agents", "position")`, int64 `[num_envs, n_agents, 2]`: (row, col) in the house; and
    `("agents", "own_reward")`, float32 `[num_envs, n_agents, 1]`, what each robot earned in the
    last step: the sum of the terms `("agents", "info", "step" | "cleaning" | "discovery")` and,
    where collisions pay, `"collision"`, with spills `"spill"`, see `marl_clean.world.rewards`; 0
    after a reset. What a network sees is added by the transforms of `marl_clean.observation` and
    `marl_clean.topology`, pure functions of `env.state` and `env.setup`, or of `env.reset_state`,
    the worlds `env.reset_rows` as the last reset began them.

    ## Rewards
    `("agents", "reward")`, float32 `[num_envs, n_agents, 1]`: what a robot is paid, its
    `own_reward` unless a transform of `marl_clean.reward` splits otherwise.

    ## Starting state
    A house drawn from `houses`, after `open_houses(k)` from the first k of them (or, with
    HouseOrder.FIXED, house i for env i), robots on distinct free cells: those of the plan, else
    drawn. Everything drawn is a pure function of (seed, env index, episode).

    ## Episode end
    `terminated`: every free cell has been cleaned at least once. `truncated`: after `max_steps`,
    or when nothing was cleaned for the first time within `stuck_after` steps.

    ## Version history
    World version 0.

    >>> from marl_clean import CleaningEnv
    >>> from marl_clean.house.base import draw_houses
    >>> from marl_clean.house.open import Open
    >>> houses = draw_houses(Open(rows=[5, 7], cols=[5, 7]), range(10), 3)
    >>> env = CleaningEnv(houses, n_agents=3, num_envs=4)
    >>> env.rollout(5)["next", "agents", "own_reward"].shape
    torch.Size([4, 5, 3, 1])

    Args:
        houses: the houses of the episodes.
        rules: the readings of the paper; see `Rules`.
        n_agents: robots in each world.
        num_envs: worlds stepped together.
        max_steps: steps until truncation; null: 4 R C // n_agents + 50 of each house's own size.
        furniture_moves_per_episode: moves of one piece by one cell, drawn at reset.
        furniture_moves_before_start: with knowledge=stale, moves since the robots memorised.
        compile: compile the pure parts of a step (some 30 s once, several times faster after);
            TorchRL takes this argument from every env and calls `compile()`.
        house_order: whether episodes draw their house, or env i always has house i.
        contact: returns which robots are in contact, for private and merged maps: a topology's.
        exchange: what robots in contact tell each other of their private maps in a step; None:
            nothing.
        first_env: index of the first world: env i of 64 equals a single env with `first_env=i`.
        seed: the seed of everything drawn.
        device: where the tensors live.

    Raises:
        BadInput: a setting out of range, or private or merged maps without `contact`.
    """

    batch_locked = True

    def __init__(
        self,
        houses: Houses,
        rules: Rules = Rules(),
        *,
        n_agents: PositiveInt = 2,
        num_envs: Worlds = 128,
        max_steps: PositiveInt | None = None,
        furniture_moves_per_episode: NonNegativeInt = 0,
        furniture_moves_before_start: NonNegativeInt = 0,
        compile: bool = False,
        house_order: HouseOrder = HouseOrder.RANDOM,
        contact: Contact | None = None,
        exchange: Telling | None = None,
        first_env: int = 0,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(device=device, batch_size=[num_envs])
        check_rules(rules, n_agents, contact, exchange, furniture_moves_before_start)
        self.n_agents = n_agents
        self.num_envs = num_envs
        self.houses = houses
        self._started = False
        self.moves = torch.tensor(MOVES, device=self.device)
        largest = max(houses.free.shape[1:])
        specs = make_specs(num_envs, n_agents, largest, rules)
        self.action_spec, self.observation_spec, self.reward_spec, self.done_spec = specs
        if isinstance(exchange, Patches) and exchange.coded:
            self.state_spec = told_specs(num_envs, n_agents, largest)
        self.to(self.device)
        self.setup = Setup(
            rules=rules,
            houses=house_tensors(houses, n_agents, max_steps, rules.margin, self.device),
            env_index=torch.arange(first_env, first_env + num_envs, device=self.device),
            seed=seed_tensor(seed, self.device),
            house_order=house_order,
            num_open=len(houses),
            furniture=FurnitureMoves(furniture_moves_per_episode, furniture_moves_before_start),
            contact=contact,
            exchange=exchange,
        )
        self._set_seed(seed)
        self.state = begin(self.setup, torch.zeros_like(self.env_index))

    @property
    def rules(self) -> Rules:
        """The readings of the paper that these worlds follow."""
        return self.setup.rules

    @property
    def env_index(self) -> Int[Tensor, " env"]:
        """The index of each world; what is drawn in it depends on it."""
        return self.setup.env_index

    @property
    def num_open(self) -> int:
        """The number of houses from which new episodes draw theirs."""
        return self.setup.num_open

    def open_houses(self, count: int) -> None:
        """Make episodes that start from now on draw from the first `count` houses only."""
        if not 1 <= count <= len(self.houses):
            raise BadInput(f"open_houses({count}): valid: 1 to {len(self.houses)}")
        self.setup = self.setup._replace(num_open=count)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None:
            rows = torch.arange(self.num_envs, device=self.device)
        else:
            rows = mask.view(self.num_envs).nonzero()[:, 0]
        self.begin_rows(rows)
        return first_frame(self.state, self.rules, self.state_spec)

    def begin_rows(
        self, rows: Int[Tensor, " row"], reads: Sequence[step.Read] = ()
    ) -> tuple[State, step.Entries]:
        """Begin the next episode in the worlds `rows`.

        Returns only these worlds, and what `reads` observe in them, computed in the same call.
        """
        episode = self.state.episode[rows] + self._started
        for index in (rows, episode):  # compiled once for any number of worlds, not for each
            torch._dynamo.maybe_mark_dynamic(index, 0)
        begin_rows_ = self.compiled(step.begin_rows_)
        fresh, entries = begin_rows_(self.state, self.setup, rows, episode, reads)
        self.reset_rows, self.reset_state = rows, fresh
        self._started = True
        return fresh, entries

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.step_worlds(tensordict.get(keys.ACTION), heard=heard_in(tensordict))

    def step_worlds(
        self,
        action: Int[Tensor, "env agent"],
        along: step.Along = step.NOTHING,
        heard: Heard | None = None,
    ) -> TensorDict:
        """Advance all worlds a step and return its frame, with what is computed `along`.

        `heard`: what robots read in a policy's messages, where they tell of cells by a code.

        Raises:
            BadInput: an action outside 0 to 3. Not checked on a GPU, where it would synchronise.
        """
        check_actions(action)
        state, setup, rules = self.state, self.setup, self.setup.rules
        if isinstance(setup.exchange, Patches):
            self.compiled(step.tell_)(state, setup, heard)
        unnoticed = None
        if rules.bump_noise:
            draw = self.compiled(unnoticed_bumps)
            unnoticed = draw(state, setup.env_index, setup.seed, rules.bump_noise)
        happens = setup.furniture.during_episode or rules.spills.per_episode
        if happens or rules.sensor is Sensor.TOUCH4:
            outcome = self.compiled(advance_)(state, action, self.moves, rules, unnoticed)
            if setup.furniture.during_episode:
                move_furniture_(state, rules.margin)
            if rules.spills.per_episode:
                spill_(state, setup)
            settled = self.compiled(step.settle_)(state, outcome, setup, along)
        else:
            step_ = self.compiled(step.step_)
            outcome, settled = step_(state, action, self.moves, setup, unnoticed, along)
        return next_frame(state, outcome, settled)

    def _set_seed(self, seed: int | None) -> None:
        """Fix everything that the env draws; the next reset starts episode 0 of this seed."""
        if seed is None:
            raise BadInput("seed=None: must be an integer")
        self.seed_in_use = seed
        self.setup = self.setup._replace(seed=seed_tensor(seed, self.device))
        self._started = False
        if "state" in self.__dict__:
            self.state.episode = torch.zeros_like(self.state.episode)

    def state_dict(self, *args: Any, **kwargs: Any) -> OrderedDict[str, Tensor]:
        """Return copies of all tensors of the state, the seed among them."""
        saved = OrderedDict((name, value.clone()) for name, value in self.state.tensors().items())
        saved["seed"] = torch.tensor(self.seed_in_use)
        saved["started"] = torch.tensor(self._started)
        saved["num_open"] = torch.tensor(self.num_open)
        return saved

    def load_state_dict(self, state_dict: Mapping[str, Tensor], *args: Any, **kwargs: Any) -> None:
        """Restore exactly the state that `state_dict` returned.

        Raises:
            BadInput: the state's sizes or names differ from this env's.
        """
        tensors = {
            name: value for name, value in state_dict.items() if name in State.__annotations__
        }
        shapes = {name: value.shape for name, value in self.state.tensors().items()}
        if {name: value.shape for name, value in tensors.items()} != shapes:
            raise BadInput("env state: sizes or names differ from this env's; same config needed")
        self._set_seed(int(state_dict["seed"]))
        self.state = State(
            **{name: value.to(self.device, copy=True) for name, value in tensors.items()}
        )
        self._started = bool(state_dict["started"])
        self.open_houses(int(state_dict["num_open"]))

    def draw(self, purpose: Purpose) -> Int[Tensor, "env agent"]:
        """Draw a number in [0, 2^32) for each robot: a function of seed, env, episode and step."""
        words = words_of_robots(self.state, self.env_index, purpose)
        return random_bits(self.seed_in_use, *words)

    def progress(self) -> dict[str, float]:
        """Return the share of free cells cleaned so far, mean over the worlds."""
        return {"coverage": float((self.state.num_visited.double() / self.state.num_free).mean())}

    def scene(self, env_index: int = 0) -> Scene:
        """Return one world's present state to draw: truth, the robots' map, and contacts."""
        setup = self.setup
        contact = None if setup.contact is None else setup.contact(self.state, setup.rules)
        return scene_of(self.state, self.rules, env_index, contact)

    def render(
        self, env_index: int = 0, cell_pixels: int | None = None
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Return one world as an RGB frame: the truth beside the robots' map.

        `cell_pixels`: the side of a cell; None: chosen by the size of the house.
        """
        return draw(self.scene(env_index), cell_pixels)
