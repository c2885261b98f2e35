"""The three terms of the reward, one function each (paper §3.3).

    step       -1                   every action
    cleaning    2 - 2 v             the robot enters a cell that counts as uncleaned
    discovery  +2                   what is learnt differs from what the map held; of a wall
                                    `wall_pays`

A robot's own reward is their sum. `held` is the record of the target cell before the step, in the
map that the robot reads or, with `paid_by=team_map`, in the union of all maps; everything that
several robots do at once is valued against it. Collisions and spills have terms of their own.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from marl_clean.settings import Cases, ObstaclePay
from marl_clean.world.rules import DISCOVERY_PAYS, Rules
from marl_clean.world.shared_map import is_known_dirty, is_known_spilt, map_value

Term = Float[Tensor, "env agent"]
Flag = Bool[Tensor, "env agent"]


def step_term(moved: Flag) -> Term:
    """Cost of an action: -1, whatever it does."""
    return torch.full_like(moved, -1.0, dtype=torch.float32)


def cleaning_term(
    held: Float[Tensor, "env agent"],
    now: Float[Tensor, "env 1"],
    moved: Flag,
    rules: Rules,
    spilt: Flag | None = None,
) -> Term:
    """Pay 2 - 2 v for entering a cell that counts as uncleaned, v its value in the map.

    Uncleaned is what is unknown, wrongly held blocked, dirty, or old enough for
    `uncleaned_at_most`; not what a spill made dirty, in truth (`spilt`) or in the map, which
    `spill_term` alone pays for.
    """
    known_free = held > 0
    old_enough = is_known_dirty(held, now, rules) | (now - held >= rules.uncleaned_after)
    uncleaned = ~known_free | old_enough
    if spilt is not None:
        uncleaned = uncleaned & ~(spilt | is_known_spilt(held))
    value = torch.where(known_free, map_value(held, now, rules), rules.unknown_pays_as)
    return torch.where(moved & uncleaned, 2 - 2 * value, 0.0)


def learnt(
    held: Float[Tensor, "env agent"], moved: Flag, bumped: Flag, rules: Rules
) -> tuple[Flag, Flag]:
    """Return which robots enter cells not known as available, and which bumps are discoveries."""
    wall_is_news = held >= 0 if rules.obstacles is ObstaclePay.FIRST else torch.ones_like(bumped)
    return moved & (held <= 0), bumped & wall_is_news


def discovery_term(entered: Flag, hit: Flag, rules: Rules) -> Term:
    """Pay 2 for what was learnt by entering a cell, `wall_pays` for what by bumping into one."""
    if rules.wall_pays == DISCOVERY_PAYS:
        return DISCOVERY_PAYS * (entered | hit)
    return torch.where(entered, DISCOVERY_PAYS, torch.where(hit, rules.wall_pays, 0.0))


def spill_term(spilt: Flag, rules: Rules) -> Term:
    """Pay `spills.pays` for entering a cell that is spilt, whatever the map says of it."""
    return torch.where(spilt, rules.spills.pays, 0.0)


def collision_term(collided: Flag, rules: Rules) -> Term:
    """Add `collision_pays` for staying because of a robot, whatever the other terms are."""
    return torch.where(collided, rules.collision_pays, 0.0)


def reward_terms(
    held: Float[Tensor, "env agent"],
    now: Float[Tensor, "env 1"],
    moved: Flag,
    bumped: Flag,
    rules: Rules,
    spilt: Flag | None = None,
) -> tuple[Term, Term, Term]:
    """Return the step, cleaning and discovery terms of one step; `spilt`: see `cleaning_term`.

    Under `cases=exclude` only the last of the three that applies is left, whatever it pays.
    """
    step = step_term(moved)
    cleaning = cleaning_term(held, now, moved, rules, spilt)
    entered, hit = learnt(held, moved, bumped, rules)
    discovery = discovery_term(entered, hit, rules)
    if rules.cases is Cases.EXCLUDE:
        learns = entered | hit
        cleaning = torch.where(learns, 0.0, cleaning)
        step = torch.where(learns | (cleaning != 0), 0.0, step)
    return step, cleaning, discovery
