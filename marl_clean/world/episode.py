"""How an episode starts: a house, places to start from, what is known of it (paper §3.4)."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from marl_clean.settings import LARGEST_SIDE, HouseOrder, Knowledge, Memory, Sensor, Starts
from marl_clean.world.distance import walking_distance
from marl_clean.world.dynamics import touch_
from marl_clean.world.exchange import Exchange, begin_exchange_
from marl_clean.world.furniture import inside_house, shift_piece
from marl_clean.world.lending import Lending, begin_lending_
from marl_clean.world.patches import Patches, begin_patches_
from marl_clean.world.random import Purpose, random_below, random_bits
from marl_clean.world.rules import Rules, knowledge_of_each
from marl_clean.world.searches import UNREACHABLE
from marl_clean.world.setup import HouseTensors, Setup
from marl_clean.world.shared_map import MEMORISED_BLOCKED, MEMORISED_FREE, UNKNOWN_RECORD
from marl_clean.world.spills import draw_spill_steps
from marl_clean.world.state import State, cell_index


def begin(setup: Setup, episode: Int[Tensor, " env"]) -> State:
    """Return the worlds of `setup` at step 0 of their episodes, starts cleaned.

    A pure function of (seed, env index, episode): no other world has a part in it.
    """
    rules, houses = setup.rules, setup.houses
    _, height, width = houses.blocked.shape
    n_agents = houses.starts.shape[1]
    house = draw_house(setup, episode)
    num_envs = len(house)
    num_maps = 1 if rules.memory is Memory.SHARED else n_agents
    blocked, piece = houses.blocked[house], houses.piece[house]
    if Knowledge.STALE in rules.kinds_of_knowledge:
        blocked, piece = _rearranged(setup, house, episode)
    zeros = torch.zeros_like(house)
    # A tensor each, `step` and `last_progress` too: what is compiled for one in the place of two
    # would be compiled anew where they differ.
    moved, bumped, collided = torch.zeros(
        (3, num_envs, n_agents), dtype=torch.bool, device=house.device
    ).unbind(0)
    state = State(
        blocked=blocked,
        piece=piece,
        house=house,
        rows=houses.rows[house],
        cols=houses.cols[house],
        num_free=houses.num_free[house],
        max_steps=houses.max_steps[house],
        furniture_moves=draw_furniture_moves(
            setup, house, episode, setup.furniture.during_episode, before_start=False
        ),
        episode=episode,
        step=zeros,
        last_progress=zeros.clone(),
        position=draw_starts(setup, house, blocked, episode),
        record=torch.full((num_envs, num_maps, height, width), UNKNOWN_RECORD, device=house.device),
        visited=torch.zeros_like(blocked),
        num_visited=zeros + n_agents,
        moved=moved,
        bumped=bumped,
        collided=collided,
        newly_cleaned=~moved,
    )
    if rules.spills.per_episode:
        state.spill_steps = draw_spill_steps(setup, house, episode)
        state.spilt = torch.zeros_like(blocked)
        state.num_spilt, state.num_open_spilt = zeros.clone(), zeros.clone()
    _memorise_(state, houses, rules)
    if rules.sensor is Sensor.TOUCH4:
        touch_(state, rules)
    _clean_starts_(state, rules)
    if isinstance(setup.exchange, Exchange):
        begin_exchange_(state)
    elif isinstance(setup.exchange, Lending):
        begin_lending_(state)
    elif isinstance(setup.exchange, Patches):
        begin_patches_(state, setup.exchange)
    return state


def draw_house(setup: Setup, episode: Int[Tensor, " env"]) -> Int[Tensor, " env"]:
    """Return which house each world plays: a drawn one of the open ones, or its own always."""
    if setup.house_order is HouseOrder.FIXED:
        return setup.env_index % len(setup.houses.blocked)
    return random_below(setup.num_open, setup.seed, setup.env_index, episode, Purpose.HOUSE)


def draw_starts(
    setup: Setup,
    house: Int[Tensor, " env"],
    blocked: Bool[Tensor, "env height width"],
    episode: Int[Tensor, " env"],
) -> Int[Tensor, "env agent 2"]:
    """Place the robots on distinct free cells: where the house says, else drawn uniformly.

    The n free cells with the highest random words. A word is drawn for the cell's place in the
    house and ends with it: padding has no part in it, and no two are equal. Together, robot 0 is
    placed so, and the others where the walk to it is shortest, of equals by their words.
    """
    houses, rules = setup.houses, setup.rules
    n_agents = houses.starts.shape[1]
    plan_starts = houses.starts[house]
    is_planned = (plan_starts >= 0).all(-1)
    if Knowledge.STALE in rules.kinds_of_knowledge:  # furniture has moved: the list is stale too
        cells = torch.arange(blocked[0].numel(), device=house.device)
        width = blocked.shape[2]
        row, col = cells // width - rules.margin, cells % width - rules.margin
        label = torch.where(blocked.flatten(1), -1, row * LARGEST_SIDE + col)
    else:
        label = houses.free_labels[house]
    occupied = torch.where(is_planned, plan_starts[..., 0] * LARGEST_SIDE + plan_starts[..., 1], -1)
    usable = (label >= 0) & (label[:, :, None] != occupied[:, None, :]).all(-1)
    label = torch.where(usable, label, 0)
    words = (setup.env_index[:, None], episode[:, None], Purpose.START, label)
    word = random_bits(setup.seed, *words)
    key = torch.where(usable, word * LARGEST_SIDE**2 + label, -1)
    if rules.starts is Starts.TOGETHER:
        first = torch.where(is_planned[:, :1], occupied[:, :1], key.amax(1, True) % LARGEST_SIDE**2)
        nearest = _nearest(key, label, first, blocked, rules.margin)
        best = nearest.gather(1, (~is_planned).cumsum(1).sub(1).clamp(min=0))
    else:
        best = key.topk(n_agents, dim=1).values % LARGEST_SIDE**2
    drawn = torch.stack([best // LARGEST_SIDE, best % LARGEST_SIDE], -1)
    return torch.where(is_planned[..., None], plan_starts, drawn)


def _nearest(
    key: Int[Tensor, "env cell"],
    label: Int[Tensor, "env cell"],
    first: Int[Tensor, "env 1"],
    blocked: Bool[Tensor, "env height width"],
    margin: int,
) -> Int[Tensor, "env cell"]:
    """Return the labels by their walk from the cell labelled `first`, the nearest first.

    Of equally near ones those of larger keys come first, and keys of -1 are last.
    """
    width = blocked.shape[2]

    def index(cell: Tensor) -> Tensor:
        place = torch.stack([cell // LARGEST_SIDE, cell % LARGEST_SIDE], -1)
        return cell_index(place, margin, width)

    source = torch.zeros_like(blocked).flatten(1).scatter(1, index(first), True)
    steps = walking_distance(~blocked, source.view_as(blocked)).flatten(1).gather(1, index(label))
    order = key.argsort(dim=1, descending=True)
    walk = torch.where(key < 0, UNREACHABLE, steps).gather(1, order)
    return label.gather(1, order.gather(1, walk.argsort(dim=1, stable=True)))


def draw_furniture_moves(
    setup: Setup,
    house: Int[Tensor, " env"],
    episode: Int[Tensor, " env"],
    count: int,
    before_start: bool,
) -> Int[Tensor, "env move 3"]:
    """Draw moves (step, piece, direction), uniform; in houses without furniture of piece 0.

    Steps are from 1 to the number of free cells: the scale of the time that cleaning takes.
    """
    if count == 0:
        return torch.zeros((len(house), 0, 3), dtype=torch.int64, device=house.device)
    houses, seed = setup.houses, setup.seed
    counter = torch.arange(count, device=house.device)[None, :] * 6 + 3 * before_start
    words = (setup.env_index[:, None], episode[:, None], Purpose.FURNITURE)
    step = 1 + random_below(houses.num_free[house, None], seed, *words, counter)
    piece = 1 + random_below(houses.num_pieces[house, None], seed, *words, counter + 1)
    piece = torch.where(houses.num_pieces[house, None] > 0, piece, 0)
    direction = random_below(4, seed, *words, counter + 2)
    return torch.stack([step, piece, direction.expand_as(step)], -1)


def _rearranged(
    setup: Setup, house: Int[Tensor, " env"], episode: Int[Tensor, " env"]
) -> tuple[Bool[Tensor, "env height width"], Int[Tensor, "env height width"]]:
    """Return (blocked, piece) after the moves since the robots memorised the house."""
    houses, count, margin = setup.houses, setup.furniture.before_start, setup.rules.margin
    blocked, piece = houses.blocked[house], houses.piece[house]
    height, width = blocked.shape[1:]
    moves = draw_furniture_moves(setup, house, episode, count, before_start=True)
    inside = inside_house(houses.rows[house], houses.cols[house], height, width, margin)
    plan_starts = cell_index(houses.starts[house], margin, width).clamp(min=0)
    starts = torch.zeros_like(blocked).flatten(1).scatter(1, plan_starts, True).view_as(blocked)
    for move in range(count):
        which, direction = moves[:, move, 1], moves[:, move, 2]
        blocked, piece = shift_piece(blocked, piece, inside, starts, which, direction)
    return blocked, piece


def _memorise_(state: State, houses: HouseTensors, rules: Rules) -> None:
    """Write the layouts that robots know into their maps: the house's as it is, or as it was."""
    each = knowledge_of_each(rules.knowledge, rules.memory, state.n_agents)
    for kind in (Knowledge.MEMORISED, Knowledge.STALE):
        if kind not in each:
            continue
        is_stale = kind is Knowledge.STALE
        layout = _memorised(
            houses.blocked[state.house] if is_stale else state.blocked, state, rules
        )
        if each.count(kind) == state.n_agents:
            state.record[:] = layout[:, None]
            continue
        for robot, known in enumerate(each):
            if known is kind:
                state.record[:, robot] = layout


def _memorised(
    blocked: Bool[Tensor, "env height width"], state: State, rules: Rules
) -> Float[Tensor, "env height width"]:
    """Return the map of robots that know the layout, ring included, and that all is dirty."""
    height, width = blocked.shape[1:]
    known = torch.where(blocked, MEMORISED_BLOCKED, MEMORISED_FREE)
    matrix = inside_house(state.rows + 2, state.cols + 2, height, width, rules.margin - 1)
    return torch.where(matrix, known, UNKNOWN_RECORD)


def _clean_starts_(state: State, rules: Rules) -> None:
    num_envs, num_maps = state.record.shape[:2]
    cell = cell_index(state.position, rules.margin, state.blocked.shape[2])
    state.visited.flatten(1).scatter_(1, cell, True)
    first = (state.step + 1).to(state.record.dtype)[:, None, None]
    own_or_all = cell[:, None, :] if num_maps == 1 else cell[:, :, None]
    state.record.flatten(2).scatter_(2, own_or_all, first.expand(own_or_all.shape).clone())
