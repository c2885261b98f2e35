"""The least time in which robots that know a small house can clean it, proven by OR-tools.

Blind robots cannot be faster: their excess over it is the price of not knowing the house, and of
suboptimal planning. OR-tools is an extra, and imported only where an optimum is computed.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from marl_clean.evaluation.bounds import bound_100, walking_distance

Place = tuple[int, int]
MOST_CELLS = 60  # free cells: for larger houses few optima are proven within the limit
TIME_LIMIT = 20.0  # per house


def optimal_T_100(
    free: Bool[np.ndarray, "row col"],
    starts: Int[np.ndarray, "robot 2"],
    time_limit: float = TIME_LIMIT,
) -> int | None:
    """The least T_100 of robots that know the house; null where it is not proven in the limit.

    Exact under the rules of the world. `time_limit` is in CP-SAT's deterministic seconds, one or
    two of the clock's, so that results do not depend on how busy the machine is.

    One robot: the shortest walk to all cells is the shortest Hamiltonian path in the complete graph
    of walking distances. Several: is there a schedule of T = `bound_100` steps, of T + 1, ...?
    A house that can be clean after T steps can be clean after T + 1.
    """
    places = tuple((int(row), int(col)) for row, col in starts)
    return _optimal(free.tobytes(), (free.shape[0], free.shape[1]), places, time_limit)


@lru_cache(maxsize=10_000)  # every policy is measured on the same houses and starts
def _optimal(
    packed: bytes, shape: tuple[int, int], starts: tuple[Place, ...], time_limit: float
) -> int | None:
    free = np.frombuffer(packed, dtype=bool).reshape(shape)
    if len(starts) == 1:
        return _shortest_walk(free, starts[0], time_limit)
    steps = int(bound_100(free[None], np.array([starts]))[0])
    while time_limit > 0:
        solved, used = _solve(_schedule(free, starts, steps), time_limit)
        if solved is None or solved >= 0:
            return None if solved is None else steps
        steps, time_limit = steps + 1, time_limit - used
    return None


NOT_POSSIBLE = -1


def _solve(model: Any, time_limit: float) -> tuple[int | None, float]:
    """The proven least cost, NOT_POSSIBLE, or null where neither is proven; and the time used."""
    from ortools.sat.python import cp_model

    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.max_deterministic_time = time_limit
    status = solver.solve(model)
    used = solver.response_proto.deterministic_time
    if status == cp_model.OPTIMAL:
        return round(solver.objective_value), used
    return (NOT_POSSIBLE if status == cp_model.INFEASIBLE else None), used


def _shortest_walk(
    free: Bool[np.ndarray, "row col"], start: Place, time_limit: float
) -> int | None:
    """Steps of the shortest walk from `start` that visits all free cells, ending anywhere."""
    from ortools.sat.python import cp_model

    cells = np.argwhere(free)
    steps = walking_distance(np.repeat(free[None], len(cells), 0), cells[:, None])
    model = cp_model.CpModel()
    nowhere = len(cells)  # closes the circuit from the last cell to the first
    arcs, cost = [], []
    for index, place in enumerate(cells):
        is_start = tuple(place) == start
        arcs.append((index, nowhere, model.new_bool_var("")))
        if is_start:
            arcs.append((nowhere, index, model.new_bool_var("")))
            continue
        for other in range(len(cells)):
            if other != index:
                arcs.append((other, index, model.new_bool_var("")))
                cost.append(int(steps[other][tuple(place)]) * arcs[-1][2])
    model.add_circuit(arcs)
    model.minimize(sum(cost))
    return _solve(model, time_limit)[0]


def _schedule(free: Bool[np.ndarray, "row col"], starts: tuple[Place, ...], steps: int) -> Any:
    """A model of the schedules of `steps` steps that clean the house: each robot's cell by step."""
    from ortools.sat.python import cp_model

    model = cp_model.CpModel()
    cells = [(int(row), int(col)) for row, col in np.argwhere(free)]
    beside = {cell: [place for place in _around(cell) if place in set(cells)] for cell in cells}
    at: list[list[dict[Place, Any]]] = []  # robot, step, cell
    for start in starts:
        nearest = walking_distance(free[None], np.array([[start]]))[0]
        times = range(steps + 1)
        at.append([{c: model.new_bool_var("") for c in cells if nearest[c] <= t} for t in times])
    for robot, path in enumerate(at):
        model.add_exactly_one(path[0].values())
        others = [other for index, other in enumerate(at) if index != robot]
        for step, (now, then) in enumerate(zip(path, path[1:], strict=False)):
            model.add_exactly_one(then.values())
            for cell, is_there in then.items():
                came_from = [now[place] for place in (cell, *beside[cell]) if place in now]
                model.add_bool_or(~is_there, *came_from)
                for other in others:  # a cell that a robot is in or leaves is occupied
                    for occupied in (other[step], other[step + 1]):
                        if cell in occupied:
                            model.add_bool_or(~is_there, ~occupied[cell])
            for cell in now:
                if len(beside[cell]) < 4:
                    continue  # beside a wall a robot can stay, by bumping into it
                stood = [other[step] for other in others]
                enters = [lower[step + 1] for lower in at[:robot]]
                collides = [a[p] for a in stood + enters for p in beside[cell] if p in a]
                model.add_bool_or(~now[cell], ~then[cell], *collides)
    for cell in cells:
        model.add_bool_or([now[cell] for path in at for now in path if cell in now])
    return model


def _around(cell: Place) -> list[Place]:
    row, col = cell
    return [(row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)]
