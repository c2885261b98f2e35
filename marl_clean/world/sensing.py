"""What robots see of the map, and of each other (paper §3.2 and §3.4)."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.world.dynamics import cells_beside, records_beside
from marl_clean.world.rules import BLOCKED_VALUE, ROBOT_VALUE, Rules
from marl_clean.world.shared_map import is_known_blocked, shown_value
from marl_clean.world.state import State, cell_index


def crop(
    record: Float[Tensor, "env map height width"],
    position: Int[Tensor, "env agent 2"],
    step: Int[Tensor, " env"],
    view_size: int,
    rules: Rules,
) -> Float[Tensor, "env agent view view"]:
    """Return the square of the map around each robot, the robot in the middle (paper §3.2).

    Read as overlapping windows, so that the cost follows the view and not the house, and
    compiled code walks whole rows. What lies outside the matrix is unknown.
    Needs `rules.margin >= view_size // 2`.
    """
    view = windows_around(record, position, view_size, rules.margin)
    now = (step + 1).to(record.dtype).view(-1, 1, 1, 1)
    return shown_value(view, now, rules)


def windows_around(
    matrix: Float[Tensor, "env map height width"],
    position: Int[Tensor, "env agent 2"],
    view_size: int,
    margin: int,
) -> Float[Tensor, "env agent view view"]:
    """Cut the square around each robot out of the one matrix, or out of its own."""
    num_envs, n_agents = position.shape[:2]
    windows = matrix.unfold(-2, view_size, 1).unfold(-2, view_size, 1)
    corner = position + (margin - view_size // 2)
    env = torch.arange(num_envs, device=position.device)[:, None]
    whose = torch.arange(n_agents, device=position.device) if matrix.shape[1] > 1 else 0
    return windows[env, whose, corner[..., 0], corner[..., 1]]


def mark_contacts(
    view: Float[Tensor, "env agent row col"],
    corner: Int[Tensor, "env agent 2"],
    position: Int[Tensor, "env agent 2"],
    contact: Bool[Tensor, "env agent agent"],
) -> Float[Tensor, "env agent row col"]:
    """Show the robots in contact as 1 in views of private maps, where nothing else shows them.

    `corner` is the place in the house that each view's first cell shows.
    """
    rows, cols = view.shape[-2:]
    row, col = (position[:, None] - corner[:, :, None]).unbind(-1)
    inside = contact & (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    index = torch.where(inside, row * cols + col, 0)
    shown = torch.where(inside, ROBOT_VALUE, BLOCKED_VALUE)  # the least value changes no cell
    return view.flatten(2).scatter_reduce(2, index, shown, "amax").view_as(view)


def not_known_blocked(state: State, rules: Rules) -> Bool[Tensor, "env agent 4"]:
    """Tell which of its four neighbours the map that each robot reads does not hold for blocked.

    In the order of the actions. All of them where none is left, which a stale map may say.
    """
    beside = records_beside(state, cells_beside(state, rules))
    ways = ~is_known_blocked(beside)
    return ways | ~ways.any(-1, keepdim=True)


def free_run(
    blocked: Bool[Tensor, "env height width"],
    position: Int[Tensor, "env agent 2"],
    compass: Int[Tensor, "direction 2"],
    range_cells: int,
    rules: Rules,
) -> Int[Tensor, "env agent direction"]:
    """Count the free cells from each robot's own to the first blocked one, up to `range_cells`.

    In steps of `compass`; a diagonal ray passes between two corners. Rays that would leave the
    matrix stay at its edge, where all is blocked.
    """
    height, width = blocked.shape[1:]
    steps = torch.arange(1, range_cells + 1, device=position.device)
    place = position[:, :, None, None] + compass[:, None] * steps[:, None] + rules.margin
    cell = place[..., 0].clamp(0, height - 1) * width + place[..., 1].clamp(0, width - 1)
    wall = blocked.flatten(1).gather(1, cell.flatten(1)).view(cell.shape)
    return (~wall).cumprod(-1).sum(-1)


def offsets(position: Int[Tensor, "env agent 2"]) -> Int[Tensor, "env agent agent 2"]:
    """Return (row, col) of robot j seen from robot i, at [env, i, j]."""
    return position[:, None, :, :] - position[:, :, None, :]


def distance_rank(position: Int[Tensor, "env agent 2"]) -> Int[Tensor, "env agent agent"]:
    """Rank the others by Euclidean distance, the robot itself 0, the nearest 1.

    Ties go to the smaller (row, col) offset, never to the robot's number, so that relabelling
    the robots relabels the ranks.
    """
    key = distance_key(offsets(position))
    return (key[..., None, :] < key[..., :, None]).sum(-1)


def distance_key(offset: Int[Tensor, "*batch 2"]) -> Int[Tensor, "*batch"]:
    """Return numbers that order offsets by their length, and then by (row, col)."""
    span = 1 << 14  # above any side of a house, so that the three parts of the key never mix
    squared = offset.square().sum(-1)
    return (squared * span + offset[..., 0] + span // 2) * span + offset[..., 1] + span // 2


def in_view(
    position: Int[Tensor, "env agent 2"], view_size: int
) -> Bool[Tensor, "env agent agent"]:
    """Each stands inside the other's square: Chebyshev distance at most view_size // 2."""
    near = offsets(position).abs().amax(-1) <= view_size // 2
    return near & everyone(position)


def in_radius(
    position: Int[Tensor, "env agent 2"], radius_cells: float
) -> Bool[Tensor, "env agent agent"]:
    """Euclidean distance at most `radius_cells`."""
    near = offsets(position).square().sum(-1) <= radius_cells**2
    return near & everyone(position)


def everyone(position: Int[Tensor, "env agent 2"]) -> Bool[Tensor, "env agent agent"]:
    """Every robot with every other."""
    num_envs, n_agents = position.shape[:2]
    itself = torch.eye(n_agents, dtype=torch.bool, device=position.device)
    return ~itself.expand(num_envs, -1, -1)


def crossed_cells(reach: int) -> Int[Tensor, "side side crossed 2"]:
    """Tabulate the cells whose interior the segment from (0, 0) to an offset meets.

    Entry [row + reach, col + reach] lists (row, col) offsets, padded with (0, 0). In units of
    half a cell the open segment meets the interior of a cell when the cell's corners do not all
    lie on one side of its line; integers decide, so a segment through a corner touches nothing.
    """
    side = torch.arange(-reach, reach + 1)
    rows, cols = torch.meshgrid(side, side, indexing="ij")
    cells = torch.stack([rows, cols], -1).flatten(0, 1)  # candidate cells
    ends = cells[:, None]  # segment ends
    corners = torch.tensor([(-1, -1), (-1, 1), (1, -1), (1, 1)]) + 2 * cells[None, :, None]
    cross = ends[:, :, None, 0] * corners[..., 1] - ends[:, :, None, 1] * corners[..., 0]
    cut = (cross > 0).any(-1) & (cross < 0).any(-1)
    lowest, highest = torch.minimum(ends, 0 * ends), torch.maximum(ends, 0 * ends)
    between = ((cells >= lowest) & (cells <= highest)).all(-1)
    met = cut & between
    most = max(int(met.sum(-1).max()), 1)
    order = met.to(torch.int8).argsort(dim=-1, descending=True, stable=True)[:, :most]
    listed = torch.where(met.gather(1, order)[..., None], cells[order], 0)
    return listed.view(2 * reach + 1, 2 * reach + 1, most, 2)


def in_sight(
    state: State, radius_cells: float, crossed: Int[Tensor, "side side crossed 2"], rules: Rules
) -> Bool[Tensor, "env agent agent"]:
    """In radius, and the segment between the centres meets no blocked cell of the true house."""
    reach = crossed.shape[0] // 2
    near = in_radius(state.position, radius_cells)
    offset = torch.where(near[..., None], offsets(state.position), 0) + reach
    path = state.position[:, :, None, None] + crossed[offset[..., 0], offset[..., 1]]
    cell = cell_index(path, rules.margin, state.blocked.shape[2])
    wall = state.blocked.flatten(1).gather(1, cell.flatten(1)).view(cell.shape).any(-1)
    return near & ~wall
