"""The tensor world set up as a drawn case says, for comparison with the plain reference."""

from collections.abc import Iterator

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from marl_clean import keys
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.shaping import Potential, Shaping
from marl_clean.house.base import Houses
from marl_clean.observation.crop import Crop
from marl_clean.reward.individual import Individual
from marl_clean.reward.neighbours import Neighbours
from marl_clean.reward.team import Team
from marl_clean.settings import HouseOrder, Knowledge, Sensor, Spills
from marl_clean.topology.full import Full
from marl_clean.topology.none import Nobody
from marl_clean.topology.radius import Radius
from marl_clean.topology.sight import Sight
from marl_clean.topology.view import View
from marl_clean.world.dynamics import touch_
from marl_clean.world.exchange import Exchange
from marl_clean.world.lending import Lending
from marl_clean.world.patches import REACH_CELLS, Patches
from marl_clean.world.rules import Rules
from marl_clean.world.setup import Telling
from marl_clean.world.shared_map import MEMORISED_BLOCKED, MEMORISED_FREE
from marl_clean.world.step import meet_
from tests.reference import Settings, World
from tests.world.strategies import Case, told

REWARDS = {"individual": Individual, "neighbours": Neighbours, "team": Team}


def topology_of(settings: Settings):
    """Build the transform that the settings name."""
    radius = None if settings.radius_cells is None else float(settings.radius_cells)
    match settings.topology:
        case "view":
            return View(settings.view_size)
        case "radius":
            return Radius(radius, settings.view_size)
        case "sight":
            return Sight(radius, settings.view_size)
        case "full":
            return Full()
        case "none":
            return Nobody()
    raise ValueError(settings.topology)


def houses_of(free, furniture, starts) -> Houses:
    """One house as the stack that envs take."""
    free = np.array(free, dtype=bool)
    pieces = np.zeros(free.shape) if furniture is None else np.array(furniture)
    return Houses(
        free=free[None],
        furniture=pieces.astype(np.int16)[None],
        rows=np.array([free.shape[0]]),
        cols=np.array([free.shape[1]]),
        starts=np.array([starts]),
        sources=["drawn"],
    )


def exchange_of(settings: Settings) -> Telling | None:
    if settings.lends:
        return Lending()
    if settings.patches:
        coded = settings.patches == "coded"
        return Patches(coded) if coded else Patches(coded, settings.patches)
    return None if settings.exchange_cells is None else Exchange(settings.exchange_cells)


def env_of(cases: list[Case], whole_map: bool = False) -> TransformedEnv:
    """The env that plays all `cases` at once; they differ in house, starts and moves alone.

    With `whole_map` the view reaches over the whole matrix from every place in it.
    """
    settings, n_agents = cases[0].settings, len(cases[0].starts)
    knowledge = settings.knowledge
    side = 2 * max(max(len(case.free), len(case.free[0])) for case in cases) + 3
    topology = topology_of(settings)
    rules = Rules(
        memory=settings.memory,
        knowledge=knowledge if isinstance(knowledge, str) else list(knowledge[:n_agents]),
        sensor=settings.sensor,
        stuck_after=settings.stuck_after,
        decay_steps=settings.decay_steps,
        decay=settings.decay,
        uncleaned_at_most=float(settings.uncleaned_at_most),
        unknown_pays_as=float(settings.unknown_value),
        cases=settings.cases,
        obstacles=settings.obstacles,
        wall_pays=float(settings.wall_pays),
        paid_by=settings.paid_by,
        collision_pays=float(settings.collision_pays),
        robots_shown=settings.robots_shown,
        robots_noted=settings.robots_noted,
        shaping=float(settings.shaping),
        spills=Spills(
            settings.spills,
            settings.spill_noticed_within,
            settings.spill_size,
            float(settings.spill_pays),
        ),
        bump_noise=settings.bump_noise,
        margin=max(side // 2, settings.view_size // 2, REACH_CELLS),
    )
    base = CleaningEnv(
        stack(cases),
        rules,
        n_agents=n_agents,
        num_envs=len(cases),
        max_steps=settings.max_steps,
        furniture_moves_per_episode=1,
        house_order=HouseOrder.FIXED,
        contact=topology.contact,
        exchange=exchange_of(settings),
    )
    crop = Crop(side if whole_map else settings.view_size)
    split = REWARDS[settings.reward]()
    if not settings.shaping:
        return TransformedEnv(base, Compose(topology, crop, split))
    shaping = Shaping(split, float(settings.shaping), float(settings.gamma))
    return TransformedEnv(base, Compose(topology, crop, Potential(), shaping))


def stack(cases: list[Case]) -> Houses:
    """The houses of several cases, padded to one size."""
    rows = max(len(case.free) for case in cases)
    cols = max(len(case.free[0]) for case in cases)
    single = [houses_of(case.free, case.furniture, case.starts) for case in cases]

    def padded(matrix: np.ndarray) -> np.ndarray:
        return np.pad(matrix, ((0, rows - matrix.shape[0]), (0, cols - matrix.shape[1])))

    return Houses(
        free=np.stack([padded(house.free[0]) for house in single]),
        furniture=np.stack([padded(house.furniture[0]) for house in single]),
        rows=np.concatenate([house.rows for house in single]),
        cols=np.concatenate([house.cols for house in single]),
        starts=np.concatenate([house.starts for house in single]),
        sources=["drawn"] * len(cases),
    )


def start(env: TransformedEnv, cases: list[Case]) -> TensorDictBase:
    """Reset the env, hand it the cases' own furniture moves, and let stale maps believe."""
    tensordict = env.reset()
    base = env.base_env
    most = max(1, *(len(case.moves) for case in cases))
    moves = torch.zeros((len(cases), most, 3), dtype=torch.int64)
    for index, case in enumerate(cases):
        for move, entry in enumerate(case.moves):
            moves[index, move] = torch.tensor(entry)
    base.state.furniture_moves = moves
    if any(case.memorised is not None for case in cases):
        believe(base, cases)
        tensordict = env.transform._reset(tensordict.empty(), tensordict)
    return tensordict


def believe(base: CleaningEnv, cases: list[Case]) -> None:
    """Write all maps anew as `begin` writes them, stale ones with the layouts of the cases."""
    margin, state = base.rules.margin, base.state
    for index, case in enumerate(cases):
        rows, cols = len(case.free), len(case.free[0])
        ring = slice(margin - 1, margin + rows + 1), slice(margin - 1, margin + cols + 1)
        maps = state.record[index]
        maps.fill_(0.0)
        for whose, record in enumerate(maps):
            knowledge = case.settings.knowledge_of(whose)
            if knowledge is Knowledge.UNKNOWN:
                continue
            is_older = knowledge is Knowledge.STALE and case.memorised is not None
            layout = torch.tensor(case.memorised if is_older else case.free)
            record[ring] = MEMORISED_BLOCKED
            inner = record[margin : margin + rows, margin : margin + cols]
            inner[:] = torch.where(layout, MEMORISED_FREE, MEMORISED_BLOCKED)
        for robot, (row, col) in enumerate(case.starts):
            maps[min(robot, len(maps) - 1), row + margin, col + margin] = 1.0
    if base.rules.sensor is Sensor.TOUCH4:
        touch_(state, base.rules)
    meet_(state, base.setup)


def say(tensordict: TensorDictBase, cases: list[Case], step: int) -> None:
    """Write into a frame, where patches are coded, what a policy made of messages."""
    if cases[0].settings.patches == "coded":
        each = [told(index, len(case.starts), step) for index, case in enumerate(cases)]
        patches, edges = zip(*each, strict=True)
        tensordict[keys.TOLD_PATCH] = torch.tensor(patches, dtype=torch.int8)
        tensordict[keys.TOLD_EDGES] = torch.tensor(edges)
        tensordict[keys.TOLD_PLACE] = tensordict[keys.POSITION]


def follow(
    env: TransformedEnv, cases: list[Case], most_steps: int
) -> Iterator[tuple[TensorDictBase, list[tuple[int, World]]]]:
    """Step env and plain worlds side by side; yield each frame and the worlds still in episodes.

    A world comes with its index in the env.
    """
    worlds = dict(enumerate(case.world(index) for index, case in enumerate(cases)))
    tensordict = start(env, cases)
    for step in range(min(most_steps, *(len(case.actions) for case in cases))):
        yield tensordict, list(worlds.items())
        actions = [case.actions[step] for case in cases]
        tensordict[keys.ACTION] = torch.tensor(actions)
        say(tensordict, cases, step)
        tensordict = step_mdp(env.step(tensordict))
        outcomes = {index: world.step(actions[index]) for index, world in worlds.items()}
        for index, outcome in outcomes.items():
            if outcome.terminated or outcome.truncated:
                del worlds[index]
