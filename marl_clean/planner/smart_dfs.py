"""`planner=smart_dfs`: the online tour whose length has a proven bound."""

from collections.abc import Mapping
from typing import final

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from marl_clean.env.cleaning import CleaningEnv
from marl_clean.planner.base import (
    Distance,
    Grid,
    Known,
    Sweep,
    around,
    first_closest,
    left_hand_rank,
    reachable,
    read_maps,
)
from marl_clean.world.distance import UNREACHABLE, neighbours, walking_distance


@final
class SmartDFS(Sweep):
    """Depth first by the left-hand rule, with short ways back and a plan where the house splits.

    Each robot keeps what is done on its left. Stuck, it walks the shortest path over cleaned
    cells to the cell that it entered last of those with an open neighbour. Where the open cells
    beside it fall into several components, the one that the current layer surrounds in part
    comes last; without such a one, the first by the left-hand rule does. A cell's layer is its
    distance, diagonals counted as 1, to the nearest cell known to be blocked.

    With the four neighbours sensed (`env.sensor=touch4`), one robot that starts beside a wall
    and a house of F cells and E boundary edges without obstacles inside, the tour and the path
    back to the start take at most F + E/2 - 3 steps.

    Several robots each do their own tour; what another has cleaned counts as visited. The bound
    is one robot's: two that meet in a passage may go to and fro there until max_steps. A robot
    without a path to a cell of its own tour does as all sweeps do: it goes to the nearest open
    cell, else to the nearest dirty one, else it acts at random.

    Source: Icking, Kamphans, Klein and Langetepe, "Exploring simple grid polygons" (2005);
    arXiv 1012.5240.
    """

    label = "smart_dfs"

    def bind(self, env: CleaningEnv) -> "SmartDFS":
        super().bind(env)
        state = env.state
        margin = 2 * (env.rules.margin - 1)
        cells = (state.blocked.shape[1] - margin) * (state.blocked.shape[2] - margin)
        shape = (*state.position.shape[:2], cells)
        self.entered = torch.zeros(shape, dtype=torch.int32, device=env.device)  # step + 1
        self.direction = torch.zeros(shape, dtype=torch.int64, device=env.device)  # on entering
        return self

    def memory(self) -> dict[str, Tensor]:
        entered, direction = self.entered.clone(), self.direction.clone()
        return {**super().memory(), "entered": entered, "direction": direction}

    def restore(self, memory: Mapping[str, Tensor]) -> None:
        super().restore(memory)
        self.entered = memory["entered"].to(self.env.device)
        self.direction = memory["direction"].to(self.env.device)

    def act(self) -> Int[Tensor, "env agent"]:
        at_start = self.track.follow(self.env.state)
        known = read_maps(self.env.state, self.env.rules)
        self._note(known, at_start)
        is_open = around(known.unvisited & known.passable, known.cell, False)
        base, has_base = self._base(known)
        onward = torch.where(is_open, self.order(known), 12).argmin(-1)
        at_base = has_base & (base == known.cell)
        action = torch.where(at_base, onward, self.nearest(known))
        back = self._path_back(known, base, has_base & ~at_base)
        return torch.where(reachable(back)[..., 0] & ~at_base, first_closest(back), action)

    def order(self, known: Known) -> Int[Tensor, "env agent 4"]:
        """Rank the directions from each robot's cell by the direction in which it entered it."""
        cell = known.cell[..., None]
        left_hand = left_hand_rank(self.direction.gather(2, cell)[..., 0])
        return left_hand + 4 * comes_last(known, left_hand)

    def _note(self, known: Known, at_start: Bool[Tensor, " env"]) -> None:
        """Record when and in which direction each robot first entered its cell."""
        self.entered = torch.where(at_start[:, None, None], 0, self.entered)
        cell = known.cell[..., None]
        walls = around(known.blocked, known.cell, False)
        behind_is_wall = walls.roll(-2, dims=-1).to(torch.int8).argmax(-1)
        heading = self.track.heading
        direction = torch.where(heading < 0, behind_is_wall, heading)[..., None]
        before = self.entered.gather(2, cell)
        now = (self.env.state.step + 1).to(torch.int32)[:, None, None]
        self.entered.scatter_(2, cell, torch.where(before > 0, before, now))
        direction = torch.where(before > 0, self.direction.gather(2, cell), direction)
        self.direction.scatter_(2, cell, direction)

    def _base(self, known: Known) -> tuple[Int[Tensor, "env agent"], Bool[Tensor, "env agent"]]:
        """Return the cell each robot entered last of those with an open neighbour."""
        beside_open = neighbours(known.unvisited & ~known.blocked, False).any(0).flatten(2)
        latest = torch.where(beside_open, self.entered, 0)
        entered, base = latest.max(-1)
        return base, entered > 0

    def _path_back(
        self, known: Known, base: Int[Tensor, "env agent"], wanted: Bool[Tensor, "env agent"]
    ) -> Int[Tensor, "env agent 4"]:
        """Return how far the base is from each robot's neighbours, over cleaned cells."""
        height, width = known.blocked.shape[2:]
        cleaned = (known.passable & ~known.unvisited).expand(-1, base.shape[1], -1, -1)
        places = torch.arange(height * width, device=base.device)
        goal = (places == base[..., None]) & wanted[..., None]
        goal = goal.view(cleaned.shape) & cleaned
        return around(walking_distance(cleaned, goal), known.cell, UNREACHABLE)


def comes_last(known: Known, left_hand: Int[Tensor, "env agent 4"]) -> Bool[Tensor, "env agent 4"]:
    """Return which directions lead to the component of open cells that is to be visited last.

    The eight cells around a robot, in a circle, show the components: runs of open cells between
    closed ones, wall (layer 0) or cleaned. A run between two cells of the robot's layer or above
    is surrounded by it, a run between two cells below is not, and a run between both kinds is so
    in part. With a single component nothing comes last.
    """
    cell = known.cell
    width = known.blocked.shape[3]
    circle = torch.tensor([-width, 1 - width, 1, width + 1, width, width - 1, -1, -width - 1])
    ring = cell[..., None] + circle.to(cell.device)
    is_open = read(known.unvisited & ~known.blocked, ring)
    layers = layers_of(known.blocked)
    own_layer, layer = read(layers, cell[..., None]), read(layers, ring)

    direction, steps = 2 * torch.arange(4)[:, None], torch.arange(1, 8)  # places in the circle
    flanks = []
    for shift in (-steps, steps):  # to the left, and to the right
        places = ((direction + shift) % 8).to(cell.device)
        first = (~is_open[..., places]).to(torch.int8).argmax(-1, keepdim=True)
        flanks.append(places.expand(*first.shape[:-1], 7).gather(-1, first)[..., 0])
    surrounded = [layer.gather(-1, flank) >= own_layer for flank in flanks]
    component = flanks[0]  # two directions into one run share its left end
    open_directions = is_open[..., ::2]
    in_part = open_directions & (surrounded[0] != surrounded[1])
    first_direction = torch.where(open_directions, left_hand, 4).argmin(-1, keepdim=True)
    first_component = component == component.gather(-1, first_direction)
    is_split = (open_directions & ~first_component).any(-1, keepdim=True)
    return is_split & torch.where(in_part.any(-1, keepdim=True), in_part, first_component)


def read(matrix: Tensor, cell: Int[Tensor, "env agent place"]) -> Tensor:
    """Read places of each robot's map [env, map, height, width]."""
    return matrix.flatten(2).expand(-1, cell.shape[1], -1).gather(2, cell)


def layers_of(blocked: Grid) -> Distance:
    """Return each cell's distance to the nearest known wall, diagonals counted as 1; 0 in walls.

    Where no wall is known at all, all cells are of one layer.
    """
    layers = torch.zeros_like(blocked, dtype=torch.int32)
    near = blocked
    grows = True
    while grows:
        layers += ~near
        wider = torch.nn.functional.max_pool2d(near.float(), 3, stride=1, padding=1) > 0
        grows = bool((wider != near).any())
        near = wider
    return layers
