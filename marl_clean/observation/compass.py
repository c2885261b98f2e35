"""`observation=compass`: what a robot needs at any scale, in numbers that do not grow."""

from typing import final

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean import keys
from marl_clean.observation._compass import (
    BLOCK_CELLS,
    BLOCK_PLANES,
    BLOCKS,
    FAR_CELLS,
    FARTHEST,
    FRESH_STEPS,
    FURTHER,
    NEARER_CELLS,
    PLANES,
    fill,
)
from marl_clean.observation._news import news_around, news_numbers
from marl_clean.observation.base import Observation
from marl_clean.settings import Form, Memory, OddFromThree, Probability
from marl_clean.world.distance import UNREACHABLE, first_steps, walking_distance
from marl_clean.world.furniture import inside_house
from marl_clean.world.noise import believed_position
from marl_clean.world.sensing import distance_key, everyone, offsets, windows_around
from marl_clean.world.setup import Setup
from marl_clean.world.shared_map import (
    is_known_blocked,
    is_known_free,
    is_known_uncleaned,
    is_unknown,
)
from marl_clean.world.state import State, cell_index
from marl_clean.world.step import Entries
from marl_clean.world.surroundings import (
    block_shares,
    closer_steps,
    continues_wall,
    in_squares,
)


@final
class Compass(Observation):
    """Where to go and what is near, in numbers that mean the same in a house of any size.

    Adds `("agents", "observation")`, float32 `[*B, n, 5 K^2 + 227]`, all in [-1, 1]; with `news`
    K^2 + 50 more. A goal
    is a cell of the house, not of its ring, that the robot's map does not know, or knows as
    available and not cleaned in this episode (never dirt that came back by ageing), or as spilt. In
    this order:

    - K x K cells around the robot, five times: blocked; unknown; cleanness (0.3 + 0.7 exp(-age
      / 12) of a cleaned cell, -1 of a known one that is not, 0 of others); (d(own cell) - d(cell))
      / 3 within [-1, 1], where d is the walking distance to the nearest goal, 0 all over without
      one; and other robots;
    - 5 x 5 blocks of 3 x 3 cells around the robot, and of 9 x 9, four times each: the share
      unknown, the share blocked, whether any is unknown, whether another robot is there;
    - for each action: does it lead nearer to a goal; is the neighbour unknown; is it blocked;
    - log2(1 + d(own cell)) / 10, with a distance of 1023 where no goal can be reached;
    - the nearest other robot: its relative (row, col) / 10, whether there is one, and
      1 / (1 + its Euclidean distance);
    - for each action whether it leads to the nearest unknown cell of the house to which no other
      robot is nearer; and its distance, as above;
    - for each action whether it leads to the nearest unknown cell of the house that does not just
      continue a known wall; and its distance;
    - with `news`: which of the K x K cells around the robot, and what share of the 5 x 5 blocks of
      3 x 3 cells and of 9 x 9, is unknown to it and known to a robot in contact. No robot can sense
      this: it is what a message would hold that tells all of it, where the receiver needs it.

    Distances are over cells known to be available; robots block no path. With private and merged
    maps everything is computed from the robot's own map, and other robots are those in contact;
    with `env.robots_shown=false` it is as if there were none.
    With `position_noise` everything is relative to the cell that the robot takes for its own.

    Its cost is searches over the known map, and reads for each robot whose number does not depend
    on the house.

    Args:
        view_size: K, the side of the square in cells, odd, at least 3.
        position_noise: see `Crop`.
        news: see above.
    """

    gives = Form.VECTOR

    def __init__(
        self, view_size: OddFromThree = 7, position_noise: Probability = 0.0, news: bool = False
    ) -> None:
        super().__init__()
        self.news = news
        self.view_size = view_size
        self.position_noise = position_noise
        self.reach_cells = max(1, view_size // 2)

    def shape(self) -> tuple[int, ...]:
        return (self._own_numbers + (news_numbers(self.view_size) if self.news else 0),)

    @property
    def _own_numbers(self) -> int:
        blocks = len(BLOCK_CELLS) * BLOCK_PLANES * BLOCKS**2
        return PLANES * self.view_size**2 + blocks + FURTHER

    def read(self, state: State, setup: Setup) -> Entries:
        by = self.by_machine_code if state.record.device.type == "cpu" else self.by_tensors
        seen = by(state, setup)
        if self.news:
            news = news_around(state, setup, self._centre(state, setup), self.view_size)
            seen = torch.cat([seen, news], -1)
        return {keys.OBSERVATION: seen}

    @torch.compiler.disable
    def by_machine_code(self, state: State, setup: Setup) -> Float[Tensor, "env agent number"]:
        """Return the observation in one pass, on a CPU."""
        centre, visible = self._centre(state, setup), seen_robots(state, setup)
        out = torch.empty((*centre.shape[:2], self._own_numbers))
        record = state.record.contiguous().numpy()
        places = (each.contiguous().numpy() for each in (state.position, centre))
        now = (state.step + 1).to(state.record.dtype).numpy()
        sizes = (state.rows.numpy(), state.cols.numpy(), now)
        margin = setup.rules.margin
        fill(
            out.numpy(),
            record,
            margin,
            *sizes,
            *places,
            visible.contiguous().numpy(),
            self.view_size,
        )
        return out

    def by_tensors(self, state: State, setup: Setup) -> Float[Tensor, "env agent number"]:
        """Return the observation by tensor operations, on any device."""
        centre, visible = self._centre(state, setup), seen_robots(state, setup)
        ring = setup.rules.margin - 1
        height, width = state.record.shape[-2:]
        record = state.record[..., ring : height - ring, ring : width - ring]
        height, width = record.shape[-2:]
        inside = inside_house(state.rows + 2, state.cols + 2, height, width, margin=0)
        blocked, passable = is_known_blocked(record), is_known_free(record)
        unknown = is_unknown(record) & inside[:, None]
        house = inside_house(state.rows, state.cols, height, width, margin=1)
        unvisited = unknown & house[:, None]
        cell, others = (cell_index(place, 1, width) for place in (centre, state.position))

        offset = offsets(state.position) - (centre - state.position)[:, :, None]
        distance = walking_distance(passable, unvisited | is_known_uncleaned(record))
        nearer, own_distance = closer_steps(distance, cell)
        ways, lengths = first_steps(  # both searches as one, which waits half as often
            torch.cat([passable, passable]),
            torch.cat([unvisited, unvisited & ~continues_wall(blocked)]),
            cell.repeat(2, 1),
            others.repeat(2, 1),
            torch.cat([visible, torch.zeros_like(visible)]),
        )
        searched = zip(ways.chunk(2), lengths.chunk(2), strict=True)
        square = self._square(state, setup, centre, distance, own_distance)
        blocks = []
        for side in BLOCK_CELLS:
            unknown_share = block_shares(unknown, centre + 1, side)
            blocks += [
                unknown_share,
                block_shares(blocked, centre + 1, side),
                (unknown_share > 0).float(),
                in_squares(offset, visible, BLOCKS, side),
            ]
        square.insert(4, in_squares(offset, visible, self.view_size, 1))
        further = [
            nearer.float(),
            *(beside(plane) for plane in (square[1], square[0])),
            log_distance(own_distance),
            nearest_robot(offset, visible),
            *(part for ways, length in searched for part in (ways.float(), log_distance(length))),
        ]
        return torch.cat([*(plane.flatten(2) for plane in (*square, *blocks)), *further], -1)

    def _square(
        self,
        state: State,
        setup: Setup,
        centre: Int[Tensor, "env agent 2"],
        distance: Int[Tensor, "env map height width"],
        own_distance: Int[Tensor, "env agent"],
    ) -> list[Float[Tensor, "env agent view view"]]:
        """Return the planes blocked, unknown, cleanness and nearer of the square around a robot."""
        margin, half = setup.rules.margin, self.view_size // 2
        record = windows_around(state.record, centre, self.view_size, margin)
        near = torch.arange(-half, half + 1, device=record.device)
        row, col = centre[..., :1] + near, centre[..., 1:] + near
        row_inside = (row >= -1) & (row <= state.rows[:, None, None])
        col_inside = (col >= -1) & (col <= state.cols[:, None, None])
        inside = row_inside[..., :, None] & col_inside[..., None, :]
        age = (state.step + 1).to(record.dtype).view(-1, 1, 1, 1) - record
        cleaned = torch.where(
            is_known_uncleaned(record), -1.0, 0.3 + 0.7 * (-age / FRESH_STEPS).exp()
        )
        around = distance.to(torch.float32)  # exact, UNREACHABLE too
        around = torch.nn.functional.pad(around, (half,) * 4, value=float(UNREACHABLE))
        around = windows_around(around, centre, self.view_size, half + 1)
        own = own_distance[..., None, None]
        nearer = (own - around).clamp(-NEARER_CELLS, NEARER_CELLS) / NEARER_CELLS
        return [
            is_known_blocked(record).float(),
            (is_unknown(record) & inside).float(),
            torch.where(is_known_free(record), cleaned, 0.0),
            torch.where(own < UNREACHABLE, nearer, 0.0),
        ]

    def _centre(self, state: State, setup: Setup) -> Int[Tensor, "env agent 2"]:
        """Return the place that each robot takes for its own."""
        if self.position_noise == 0:
            return state.position
        return believed_position(state, setup.env_index, setup.seed, self.position_noise)


def seen_robots(state: State, setup: Setup) -> Bool[Tensor, "env agent agent"]:
    """Return the others whose place each robot knows: all on a shared map, else its contacts.

    Nobody without `robots_shown`.
    """
    if not setup.rules.robots_shown:
        return torch.zeros_like(everyone(state.position))
    if setup.rules.memory is Memory.SHARED or setup.contact is None:
        return everyone(state.position)
    return setup.contact(state, setup.rules)


def beside(plane: Float[Tensor, "env agent view view"]) -> Float[Tensor, "env agent 4"]:
    """Return a plane's values at the neighbours up, right, down and left."""
    half = plane.shape[-1] // 2
    four = ((half - 1, half), (half, half + 1), (half + 1, half), (half, half - 1))
    return torch.stack([plane[..., row, col] for row, col in four], -1)


def log_distance(distance: Int[Tensor, "env agent"]) -> Float[Tensor, "env agent 1"]:
    """Return log2(1 + d) / 10 of walking distances, at most 1."""
    return (distance.clamp(max=FARTHEST).float() + 1).log2().unsqueeze(-1) / 10


def nearest_robot(
    offset: Int[Tensor, "env agent agent 2"],
    visible: Bool[Tensor, "env agent agent"],
) -> Float[Tensor, "env agent 4"]:
    """Return the nearest visible robot's relative place, whether there is one, and its nearness."""
    nearest = torch.where(visible, distance_key(offset), torch.iinfo(torch.int64).max).argmin(-1)
    index = nearest[..., None, None].expand(-1, -1, 1, 2)
    place = offset.gather(2, index)[:, :, 0].float()
    near = 1 / (1 + place.square().sum(-1, keepdim=True).sqrt())
    where = (place / FAR_CELLS).clamp(-1, 1)
    any_seen = visible.any(-1, keepdim=True)
    return torch.cat([where, torch.ones_like(near), near], -1) * any_seen
