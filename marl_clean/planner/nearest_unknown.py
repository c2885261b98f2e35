"""`planner=nearest_unknown`: the rival that the paper weighs and sets aside (§3.2)."""

import numpy as np
import torch
from jaxtyping import Bool, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from marl_clean.planner.base import Planner
from marl_clean.settings import Assignment
from marl_clean.world.distance import UNREACHABLE, neighbours, walking_distance
from marl_clean.world.shared_map import is_known_blocked, is_known_dirty, is_unknown

Grid = Bool[Tensor, "env map height width"]
Distance = Int[Tensor, "env map height width"]


class NearestUnknown(Planner):
    """Each step anew, each robot walks to the nearest cell that its map does not know.

    Breadth first over cells not known to be blocked and not occupied now, ties in the order up,
    right, down, left; none reachable: the nearest dirty cell; none: a random action.

    Breadth-first search finds of all shortest ways the first in the order of the actions. So one
    flood from all targets serves every robot: its action is the first one that leads closer.

    Args:
        assignment: none: each robot for itself. greedy: of all pairs of a robot and a target
            the closest is taken first (ties: the lower robot, then what its search finds first),
            until every robot has one of its own. hungarian: the least sum of distances.
            Robots that reach an unknown cell compete for those, the others for the dirty ones;
            a robot for which no target is left goes for its own nearest.
    """

    def __init__(self, assignment: Assignment = Assignment.NONE) -> None:
        super().__init__()
        self.assignment = assignment

    @property
    def label(self) -> str:
        plain = self.assignment is Assignment.NONE
        return "nearest_unknown" if plain else f"nearest_unknown+{self.assignment.value}"

    def act(self) -> Int[Tensor, "env agent"]:
        distances = self.distances()
        return torch.where(
            reachable(distances)[..., 0], first_closest(distances), self.random_action()
        )

    def distances(self) -> Int[Tensor, "env agent 4"]:
        """Return how far each robot's target is from its up, right, down and left neighbour."""
        state, rules = self.env.state, self.env.rules
        matrix = slice(rules.margin - 1, 1 - rules.margin or None)  # the house and its ring
        record = state.record[..., matrix, matrix]
        now = (state.step + 1).to(record.dtype).view(-1, 1, 1, 1)
        width = record.shape[3]
        cell = (state.position[..., 0] + 1) * width + state.position[..., 1] + 1
        occupied = torch.zeros_like(record[:, 0], dtype=torch.bool).flatten(1)
        occupied = occupied.scatter(1, cell, True).view_as(record[:, :1])
        passable = ~is_known_blocked(record) & ~occupied
        unknown = is_unknown(record) & ~occupied
        dirty = is_known_dirty(record, now, rules) & ~occupied

        to_unknown = around(walking_distance(passable, unknown), cell)
        to_dirty = around(walking_distance(passable, dirty), cell)
        explores = reachable(to_unknown)
        distances = torch.where(explores, to_unknown, to_dirty)
        if self.assignment is not Assignment.NONE:
            assign = assign_greedily if self.assignment is Assignment.GREEDY else assign_optimally
            to_own = torch.where(
                explores,
                assign(passable, unknown, cell, explores[..., 0]),
                assign(passable, dirty, cell, ~explores[..., 0]),
            )
            distances = torch.where(reachable(to_own), to_own, distances)
        return distances


def around(distance: Distance, cell: Int[Tensor, "env agent"]) -> Int[Tensor, "env agent 4"]:
    """Read the distance of each robot's up, right, down and left neighbour from its map."""
    four = neighbours(distance, UNREACHABLE).flatten(-2).permute(1, 2, 3, 0)
    four = four.expand(-1, cell.shape[1], -1, -1)
    return four.gather(2, cell[..., None, None].expand(-1, -1, 1, 4))[:, :, 0]


def reachable(distances: Int[Tensor, "env agent 4"]) -> Bool[Tensor, "env agent 1"]:
    """Tell which robots have a way."""
    return (distances < UNREACHABLE).any(-1, keepdim=True)


def first_closest(distances: Int[Tensor, "*robots 4"]) -> Int[Tensor, "*robots"]:
    """Return the first action, in their order, that leads closest."""
    order = torch.arange(4, device=distances.device)
    return (distances.long() * 4 + order).argmin(-1)


def assign_greedily(
    passable: Grid,
    targets: Grid,
    cell: Int[Tensor, "env agent"],
    competes: Bool[Tensor, "env agent"],
) -> Int[Tensor, "env agent 4"]:
    """Return the neighbours' distances to the target that each robot is assigned.

    As many rounds as robots: flood from the targets left, take the closest robot that has none
    yet, walk its first shortest way to see which target it is, and strike that from all maps.
    """
    num_envs, n_agents = cell.shape
    env = torch.arange(num_envs, device=cell.device)
    assigned = torch.full_like(competes, UNREACHABLE, dtype=torch.int32)[..., None].repeat(1, 1, 4)
    waiting = competes
    for _ in range(n_agents):
        distance = walking_distance(passable, targets)
        beside = around(distance, cell)
        nearest = torch.where(waiting, beside.amin(-1), UNREACHABLE)
        robot = first_minimum(nearest)
        found = nearest[env, robot] < UNREACHABLE
        if not found.any():
            break
        which_map = robot if distance.shape[1] > 1 else torch.zeros_like(robot)
        target = _walk(distance[env, which_map], cell[env, robot], found)
        winner = (torch.arange(n_agents, device=cell.device) == robot[:, None]) & found[:, None]
        assigned = torch.where(winner[..., None], beside, assigned)
        waiting = waiting & ~winner
        struck = targets.flatten(2).clone()
        struck[env[found], :, target[found]] = False
        targets = struck.view_as(targets)
    return assigned


def first_minimum(values: Int[Tensor, "env agent"]) -> Int[Tensor, " env"]:
    """Return the lowest index of the smallest value."""
    order = torch.arange(values.shape[1], device=values.device)
    return (values.long() * values.shape[1] + order).argmin(-1)


def _walk(
    distance: Int[Tensor, "env height width"],
    cell: Int[Tensor, " env"],
    walking: Bool[Tensor, " env"],
) -> Int[Tensor, " env"]:
    """Follow the first shortest way down to distance 0 and return the cell where it ends."""
    width = distance.shape[2]
    four = neighbours(distance, UNREACHABLE).flatten(2).permute(1, 2, 0)  # env cell 4
    flat = distance.flatten(1)
    step = torch.tensor([-width, 1, width, -1], device=cell.device)
    env = torch.arange(len(cell), device=cell.device)
    while walking.any():
        onward = cell + step[first_closest(four[env, cell])]
        cell = torch.where(walking, onward, cell)
        walking = walking & (flat[env, cell] > 0)
    return cell


def assign_optimally(
    passable: Grid,
    targets: Grid,
    cell: Int[Tensor, "env agent"],
    competes: Bool[Tensor, "env agent"],
) -> Int[Tensor, "env agent 4"]:
    """Return the neighbours' distances to each robot's target under the least sum of distances.

    SciPy's `linear_sum_assignment` decides, one world at a time; only the n nearest targets of
    each of n robots can be part of a best assignment. As many robots as possible get a target.
    """
    num_envs, n_agents = cell.shape
    shape = (num_envs, n_agents, *targets.shape[2:])
    passable, targets = passable.expand(shape), targets.expand(shape)
    start = torch.zeros_like(targets).flatten(2).scatter(2, cell[..., None], True)
    way = walking_distance(passable, start.view(shape))
    cost = torch.where(targets & competes[..., None, None], way, UNREACHABLE).flatten(2)
    nearest = cost.topk(min(n_agents, cost.shape[2]), dim=2, largest=False).indices
    candidates = nearest.flatten(1)  # a target twice is harmless: the copy is struck below
    table = cost.gather(2, candidates[:, None].expand(-1, n_agents, -1)).cpu().numpy()
    column = np.full((num_envs, n_agents), -1)
    for env, (costs, cells) in enumerate(zip(table, candidates.cpu().numpy(), strict=True)):
        _, once = np.unique(cells, return_index=True)
        robots, chosen = linear_sum_assignment(np.minimum(costs[:, once], _TOO_FAR))
        within = costs[robots, once[chosen]] < UNREACHABLE
        column[env, robots[within]] = once[chosen[within]]
    chosen_column = torch.from_numpy(column).to(cell.device)
    target = candidates.gather(1, chosen_column.clamp(min=0))
    goal = torch.zeros_like(start).scatter(2, target[..., None], True)
    goal &= (chosen_column >= 0)[..., None]
    return around(walking_distance(passable, goal.view(shape)), cell)


_TOO_FAR = 10**7  # of no way: above any sum of real distances
