"""The reference world against the rules: named cases worked out by hand, then invariants."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from marl_clean.settings import (
    Assignment,
    Cases,
    Decay,
    Knowledge,
    Memory,
    ObstaclePay,
    PaidBy,
    Sensor,
)
from tests.reference import (
    DOWN,
    LEFT,
    PER_CENTS,
    RIGHT,
    UP,
    Episode,
    Grid,
    Pieces,
    Place,
    Record,
    Settings,
    World,
    assigned,
    assignment_cost,
    bounds,
    explores,
    measures,
    nearest_unknown,
    need,
    play,
    ratio,
    search,
    targets,
    union,
)
from tests.world.strategies import Case, cases

JUST_UNDER_HALF = Fraction(499, 1000)


def drawn(*lines: str) -> tuple[Grid, Pieces, list[Place]]:
    """`#` wall, letters furniture (A is piece 1), digits robots on free cells, the rest free."""
    free = [[not (cell == "#" or cell.isalpha()) for cell in line] for line in lines]
    pieces = [
        [ord(cell) - ord("A") + 1 if cell.isalpha() else 0 for cell in line] for line in lines
    ]
    robots = {
        int(cell): (row, col)
        for row, line in enumerate(lines)
        for col, cell in enumerate(line)
        if cell.isdigit()
    }
    return free, pieces, [robots[number] for number in sorted(robots)]


def world(
    *lines: str,
    moves: Sequence[tuple[int, int, int]] = (),
    memorised: Grid | None = None,
    **readings: Any,
) -> World:
    free, pieces, starts = drawn(*lines)
    return World(free, starts, Settings(**readings), pieces, moves, memorised)


def own(world: World, *actions: int) -> list[Fraction]:
    """Each robot's own reward of one step."""
    return world.step(actions).own_reward


def decimal(*texts: str) -> list[Fraction]:
    return [Fraction(text) for text in texts]


# --------------------------------------------------------------------------- reward (§3.3)


class TestReward:
    def test_first_clean_cell_pays_3_4(self) -> None:
        outcome = world("0..").step([RIGHT])
        assert outcome.moved == [True]
        assert [*outcome.step, *outcome.cleaning, *outcome.discovery] == decimal("-1", "2.4", "2")
        assert outcome.own_reward == decimal("3.4")

    def test_first_bump_pays_1_and_the_next_nothing(self) -> None:
        bumping = world("0..")
        assert own(bumping, UP) == [1]
        assert own(bumping, UP) == [-1]

    @pytest.mark.parametrize(("cases", "reward"), [(Cases.ADD, "-0.5"), (Cases.EXCLUDE, "0.5")])
    def test_discovering_a_wall_pays_what_it_is_said_to(self, cases: Cases, reward: str) -> None:
        bumping = world("0..", cases=cases, wall_pays=0.5)
        assert own(bumping, UP) == decimal(reward)
        assert own(bumping, UP) == [-1]
        assert bumping.step([RIGHT]).discovery == [2]

    def test_a_discovery_that_pays_nothing_still_excludes(self) -> None:
        assert own(world("0..", cases=Cases.EXCLUDE, wall_pays=0), UP) == [0]

    def test_cleaned_cell_costs_the_step(self) -> None:
        back = world("0..")
        back.step([RIGHT])
        assert own(back, LEFT) == [-1]

    def test_dirty_cell_cleaned_again_pays_1(self) -> None:
        slow = world("0..", decay_steps=4)  # dirty at age 2
        slow.step([RIGHT])
        slow.step([UP])
        assert own(slow, LEFT) == [1]

    def test_every_cell_pays_so_back_and_forth_costs_nothing(self) -> None:
        back = world("0..", uncleaned_at_most=JUST_UNDER_HALF)
        back.step([RIGHT])
        assert own(back, LEFT) == decimal("0.01")  # 2 - 2 (0.5 - 1/200) - 1

    def test_uncleaned_at_most_includes_its_own_value(self) -> None:
        ages = world("0..", uncleaned_at_most=0.25, decay_steps=8)
        ages.step([RIGHT])
        ages.step([UP])
        assert own(ages, LEFT) == decimal("0.5")  # v = 0.5 - 2/8

    @pytest.mark.parametrize(("unknown_value", "reward"), [(Fraction(-1, 5), "3.4"), (0, "3")])
    def test_unknown_value(self, unknown_value: Fraction, reward: str) -> None:
        assert own(world("0..", unknown_value=unknown_value), RIGHT) == decimal(reward)

    def test_cases_exclude_each_other(self) -> None:
        slow = world("0..", cases=Cases.EXCLUDE, decay_steps=4)
        outcome = slow.step([RIGHT])
        assert [*outcome.step, *outcome.cleaning, *outcome.discovery] == [0, 0, 2]
        assert own(slow, UP) == [2]
        assert own(slow, UP) == [-1]
        outcome = slow.step([LEFT])
        assert [*outcome.step, *outcome.cleaning, *outcome.discovery] == [0, 2, 0]

    def test_obstacles_pay_at_every_bump(self) -> None:
        bumping = world("0..", obstacles=ObstaclePay.EVERY)
        assert [own(bumping, UP) for _ in range(3)] == [[1], [1], [1]]

    def test_two_robots_bump_one_unknown_cell_both_paid(self) -> None:
        assert own(world("0#1", "..."), RIGHT, LEFT) == [1, 1]

    def test_private_maps_pay_by_the_robots_own_map(self) -> None:
        apart = world("0.1", memory=Memory.PRIVATE, topology="none")
        apart.step([RIGHT, UP])
        apart.step([LEFT, UP])
        assert own(apart, UP, LEFT) == decimal("1", "3.4")


class TestWhoIsPaid:
    LINE = ("0..1..2",)  # robots 0 and 1 in contact, 1 and 2 too, 0 and 2 not

    @pytest.mark.parametrize(
        ("split", "rewards"),
        [
            ("individual", ("3.4", "1", "-1")),
            ("neighbours", ("4.4", "3.4", "0")),
            ("team", ("3.4", "3.4", "3.4")),
        ],
    )
    def test_splits(self, split: str, rewards: tuple[str, ...]) -> None:
        line = world(*self.LINE, view_size=7, reward=split)
        line.map_of(2)[(-1, 6)] = Record(blocked=True, written=0)
        assert line.step([RIGHT, UP, UP]).reward == decimal(*rewards)

    def test_contact_counts_before_the_step(self) -> None:
        parting = world(".01.", view_size=3, reward="neighbours")
        assert parting.step([LEFT, RIGHT]).reward == decimal("6.8", "6.8")
        assert parting.step([UP, UP]).reward == [1, 1]


# --------------------------------------------------------------------------- moves


class TestMoves:
    def test_robots_never_swap(self) -> None:
        facing = world(".01.")
        outcome = facing.step([RIGHT, LEFT])
        assert outcome.collided == [True, True]
        assert outcome.own_reward == [-1, -1]
        assert facing.positions == [(0, 1), (0, 2)]

    def test_collision_writes_nothing(self) -> None:
        apart = world("10.", memory=Memory.PRIVATE, topology="none")
        apart.step([LEFT, UP])
        assert (0, 0) not in apart.map_of(0)

    def test_a_cell_left_in_this_step_is_not_entered(self) -> None:
        train = world("01.")
        outcome = train.step([RIGHT, RIGHT])
        assert outcome.moved == [False, True]
        assert outcome.collided == [True, False]

    def test_three_into_one_cell_the_lowest_enters(self) -> None:
        ring = world("#2#", "1.0", "...")
        outcome = ring.step([LEFT, RIGHT, DOWN])
        assert outcome.moved == [True, False, False]
        assert outcome.collided == [False, True, True]
        assert ring.positions == [(1, 1), (1, 0), (0, 1)]

    def test_the_ring_stops_robots_and_is_written_like_a_wall(self) -> None:
        lane = world("0.")
        assert lane.step([LEFT]).bumped == [True]
        assert lane.map_values(0) == [[-0.2] * 4, [-1.0, 1.0, -0.2, -0.2], [-0.2] * 4]

    def test_staying_cleans_too(self) -> None:
        still = world("0..", decay_steps=4)
        for _ in range(4):
            still.step([UP])
        assert still.map_of(0)[(0, 0)] == Record(False, written=4, cleaned=4)


# --------------------------------------------------------------------------- the map (§3.2)


class TestDecay:
    @pytest.mark.parametrize(
        ("decay", "decay_steps", "values"),
        [
            (Decay.FORMULA, 4, ["0.25", "0", "0", "0", "0"]),
            (Decay.SENTENCE, 4, ["0.375", "0.25", "0.125", "0", "0"]),
            (Decay.FORMULA, 5, ["0.3", "0.1", "0", "0", "0"]),
            (Decay.FORMULA, 1, ["0", "0", "0", "0", "0"]),
        ],
    )
    def test_value_by_age(self, decay: Decay, decay_steps: int, values: list[str]) -> None:
        left = world("0..", decay=decay, decay_steps=decay_steps)
        left.step([RIGHT])
        seen = [left.seen(0)[0, 0]]
        for _ in values[1:]:
            left.step([UP])
            seen.append(left.seen(0)[0, 0])
        assert seen == decimal(*values)

    @pytest.mark.parametrize("decay", Decay)
    def test_without_decay_what_is_clean_stays_clean(self, decay: Decay) -> None:
        left = world("0..", decay=decay, decay_steps=None, uncleaned_at_most=JUST_UNDER_HALF)
        left.step([RIGHT])
        for _ in range(300):
            left.step([UP])
        assert left.seen(0)[0, 0] == Fraction(1, 2)
        assert own(left, LEFT) == [-1]

    @pytest.mark.parametrize(("decay", "age"), [(Decay.FORMULA, 100), (Decay.SENTENCE, 200)])
    def test_dirty_age_of_the_default(self, decay: Decay, age: int) -> None:
        assert Settings(decay=decay).dirty_age == age


class TestMemory:
    def test_full_ignorance_at_first(self) -> None:
        assert world("0..").map_values(0) == [[-0.2] * 5, [-0.2, 1.0, *[-0.2] * 3], [-0.2] * 5]

    def test_view_is_a_crop_with_unknown_outside(self) -> None:
        corner = world("0.", "..", view_size=5)
        corner.step([UP])
        corner.step([LEFT])
        unknown = [-0.2] * 5
        assert corner.view(0) == [
            unknown,
            [-0.2, -0.2, -1.0, -0.2, -0.2],
            [-0.2, -1.0, 1.0, -0.2, -0.2],
            unknown,
            unknown,
        ]
        assert corner.view(0, 1) == [[1.0]]

    def test_shared_shows_all_robots_whatever_the_contact(self) -> None:
        assert world("0..1", topology="none").seen(0)[0, 3] == 1

    def test_private_shows_others_in_contact_only(self) -> None:
        line = world("0.1.2", memory=Memory.PRIVATE, view_size=5)
        assert [line.seen(0)[0, col] for col in (0, 2, 4)] == [1, 1, Fraction(-1, 5)]
        assert [line.seen(1)[0, col] for col in (0, 2, 4)] == [1, 1, 1]

    def test_private_writes_into_the_own_map_only(self) -> None:
        pair = world("01", memory=Memory.PRIVATE)
        pair.step([UP, DOWN])
        assert set(pair.map_of(0)) == {(0, 0), (-1, 0)}
        assert set(pair.map_of(1)) == {(0, 1), (1, 1)}

    def test_merged_is_pairwise_and_not_transitive(self) -> None:
        line = world("0.1.2", memory=Memory.MERGED, view_size=5)
        assert [sorted(known) for known in line.maps] == [
            [(0, 0), (0, 2)],
            [(0, 0), (0, 2), (0, 4)],
            [(0, 2), (0, 4)],
        ]

    def test_union_the_later_wins_of_equals_blocked(self) -> None:
        place = (0, 0)
        blocked, cleaned = Record(True, written=3), Record(False, written=3, cleaned=3)
        later, touched = Record(False, written=4, cleaned=4), Record(False, written=3)
        for strong, weak in [(blocked, cleaned), (later, blocked), (cleaned, touched)]:
            assert union({place: strong}, {place: weak}) == {place: strong}
            assert union({place: weak}, {place: strong}) == {place: strong}


class TestKnowledge:
    def test_memorised_knows_the_layout_and_all_of_it_is_dirty(self) -> None:
        known = world("0.#", knowledge=Knowledge.MEMORISED)
        assert known.map_values(0) == [[-1.0] * 5, [-1.0, 1.0, 0.0, -1.0, -1.0], [-1.0] * 5]
        assert own(known, UP) == [-1]
        assert own(known, RIGHT) == [1]
        assert own(known, RIGHT) == [-1]

    @pytest.mark.parametrize(("unknown_value", "reward"), [(Fraction(-1, 5), "3.4"), (0, "3")])
    def test_stale_pays_for_what_was_wrong(self, unknown_value: Fraction, reward: str) -> None:
        believed, _, _ = drawn("..A.", "....")
        stale = world(
            ".0.A",
            "....",
            knowledge=Knowledge.STALE,
            memorised=believed,
            unknown_value=unknown_value,
        )
        assert stale.seen(0)[0, 2] == -1
        assert stale.seen(0)[0, 3] == 0
        assert own(stale, RIGHT) == decimal(reward)  # enters a cell believed blocked
        assert own(stale, RIGHT) == [1]  # bumps into a cell believed available
        assert own(stale, RIGHT) == [-1]

    def test_each_robot_of_a_team_knows_its_own(self) -> None:
        believed, _, _ = drawn("..A.", "....")
        kinds = (Knowledge.UNKNOWN, Knowledge.STALE, Knowledge.MEMORISED)
        readings = {"knowledge": kinds, "memory": Memory.PRIVATE, "paid_by": PaidBy.TEAM_MAP}
        team = world("01.A", "2...", memorised=believed, **readings)
        assert [known.get((0, 2)) for known in team.maps] == [
            None,
            Record(True, written=-1),
            Record(False, written=-1),
        ]
        # Of equally old records blocked wins: the team's map is wrong where the stale one is.
        assert own(team, LEFT, RIGHT, DOWN) == [-1, Fraction("3.4"), -1]


class TestTeam:
    @pytest.mark.parametrize("memory", [Memory.PRIVATE, Memory.MERGED])
    def test_the_teams_map_pays_once(self, memory: Memory) -> None:
        readings = {"memory": memory, "topology": "none"}
        paid = {}
        for paid_by in PaidBy:
            pair = world("0..1", paid_by=paid_by, **readings)
            pair.step([RIGHT, UP])
            pair.step([LEFT, LEFT])
            paid[paid_by] = own(pair, UP, LEFT)
        assert paid[PaidBy.OWN_MAP] == [1, Fraction("3.4")]
        assert paid[PaidBy.TEAM_MAP] == [1, -1]

    @pytest.mark.parametrize("cases", Cases)
    def test_a_collision_is_paid_beside_the_other_terms(self, cases: Cases) -> None:
        pair = world("01", "..", collision_pays=Fraction(-1, 2), cases=cases, reward="team")
        outcome = pair.step([RIGHT, DOWN])
        assert outcome.collision == [Fraction(-1, 2), 0]
        assert outcome.step[0] == -1 and outcome.own_reward[0] == Fraction(-3, 2)
        assert outcome.reward[0] == sum(outcome.own_reward)

    def test_the_return_counts_collisions(self) -> None:
        pair = world("01.", collision_pays=-3)
        result = measures(play(pair, [[RIGHT, LEFT]]))
        assert result["return"] == -8 and result["collisions"] == 2

    def test_robots_not_shown_leave_what_the_map_holds(self) -> None:
        pair = world("01", robots_shown=False)
        assert pair.seen(0)[0, 0] == 1 and pair.seen(0)[0, 1] == Fraction(1, 2)
        alone = world("01", robots_shown=False, memory=Memory.PRIVATE)
        assert alone.seen(0)[0, 1] == Fraction(-1, 5)


class TestTouch:
    def test_the_four_neighbours_are_known_and_dirty_from_step_0(self) -> None:
        touching = world(".0#", "...", sensor=Sensor.TOUCH4)
        assert touching.map_of(0) == {
            (0, 1): Record(False, written=0, cleaned=0),
            (-1, 1): Record(True, written=0),
            (0, 2): Record(True, written=0),
            (1, 1): Record(False, written=0),
            (0, 0): Record(False, written=0),
        }
        assert own(touching, RIGHT) == [-1]  # nothing learnt by the bump
        assert own(touching, LEFT) == [1]  # dirty, but known

    def test_a_known_available_cell_stays_as_it_is(self) -> None:
        touching = world("0..", sensor=Sensor.TOUCH4)
        touching.step([RIGHT])
        assert touching.map_of(0)[(0, 0)] == Record(False, written=0, cleaned=0)


class TestFurniture:
    def test_a_piece_moves_after_the_robots_and_the_map_keeps_its_belief(self) -> None:
        moving = world("0.A.", "....", moves=[(1, 1, LEFT)], knowledge=Knowledge.MEMORISED)
        moving.step([UP])
        assert moving.free[0] == [True, False, True, True]
        assert moving.seen(0)[0, 1] == 0
        assert moving.seen(0)[0, 2] == -1
        assert own(moving, RIGHT) == [1]

    def test_a_vacated_cell_is_dirty_again(self) -> None:
        moving = world("0.A.", "....", moves=[(2, 1, LEFT), (3, 1, RIGHT)])
        moving.step([RIGHT])
        moving.step([DOWN])
        assert moving.coverage() == (2, 7)  # (0, 1) was cleaned and is covered now
        moving.step([UP])
        assert moving.coverage() == (2, 7)
        assert moving.step([UP]).newly_cleaned == [True]

    @pytest.mark.parametrize(
        ("lines", "direction"),
        [
            (("0A.", "..."), LEFT),  # a robot
            (("0A.", "..."), UP),  # out of the house
            (("0A#", "..."), RIGHT),  # a wall
            (("0AB", "..."), RIGHT),  # another piece
            (("0.A", "..#", "..."), LEFT),  # the vacated corner would be cut off
        ],
    )
    def test_forbidden_moves_are_skipped(self, lines: tuple[str, ...], direction: int) -> None:
        moving = world(*lines, moves=[(1, 1, direction)])
        before = moving.free
        moving.step([UP])
        assert moving.free == before

    def test_a_piece_may_take_the_cell_a_robot_just_left(self) -> None:
        moving = world("0A.", "...", moves=[(1, 1, LEFT)])
        moving.step([DOWN])
        assert moving.furniture[0] == [1, 0, 0]

    def test_robots_touch_what_the_moves_left(self) -> None:
        moving = world("0.A.", "....", moves=[(1, 1, LEFT)], sensor=Sensor.TOUCH4)
        moving.step([UP])
        assert moving.map_of(0)[(0, 1)] == Record(True, written=1)

    def test_moves_of_one_step_apply_in_list_order(self) -> None:
        both = [(1, 2, RIGHT), (1, 1, RIGHT)]
        ordered, reverse = world("AB.", "..0", moves=both), world("AB.", "..0", moves=both[::-1])
        ordered.step([LEFT])
        reverse.step([LEFT])
        assert ordered.furniture[0] == [0, 1, 2]
        assert reverse.furniture[0] == [1, 0, 2]


# --------------------------------------------------------------------------- contact (§3.4)


class TestTopology:
    @pytest.mark.parametrize(
        ("lines", "topology", "live"),
        [
            (("0....", ".....", "..1.."), "view", True),  # Chebyshev 2 = 5 // 2
            (("0..1.", ".....", "....."), "view", False),
            (("0.1..", ".....", "....."), "radius", True),
            (("0....", ".....", "..1.."), "radius", False),  # sqrt(8) > 2
            (("0.1..", ".....", "....."), "sight", True),
            (("0#1..", ".....", "....."), "sight", False),
            (("0#...", "#1...", "....."), "sight", True),  # touches corners, no interior
            (("0#...", "..1..", "....."), "sight", False),
            (("0....", ".....", "....1"), "full", True),
            (("01...", ".....", "....."), "none", False),
        ],
    )
    def test_levels(self, lines: tuple[str, ...], topology: str, live: bool) -> None:
        radius = 3 if lines[1] == "..1.." else None
        pair = world(*lines, topology=topology, view_size=5, radius_cells=radius)
        assert pair.contacts() == [[False, live], [live, False]]

    def test_distance_rank_breaks_ties_by_offset(self) -> None:
        cross = world(".1.", "203", ".4.")
        assert cross.distance_rank()[0] == [0, 1, 2, 3, 4]
        assert cross.distance_rank()[4] == [1, 4, 2, 3, 0]


# --------------------------------------------------------------------------- the end


class TestEnd:
    def test_terminated_when_all_is_cleaned_even_at_the_limit(self) -> None:
        outcome = world("0.", max_steps=1).step([RIGHT])
        assert (outcome.terminated, outcome.truncated) == (True, False)

    def test_truncated_at_max_steps(self) -> None:
        outcome = world("0..", max_steps=1).step([RIGHT])
        assert (outcome.terminated, outcome.truncated) == (False, True)

    def test_default_max_steps_is_of_the_house(self) -> None:
        assert world("0.1", "...").max_steps == 4 * 2 * 3 // 2 + 50

    def test_stuck(self) -> None:
        idle = world("0...", stuck_after=3)
        actions = [RIGHT, UP, UP, UP]
        assert [idle.step([action]).truncated for action in actions] == [False] * 3 + [True]

    def test_certificate(self) -> None:
        lane = world("0.")
        for action in [UP, LEFT, DOWN, RIGHT, UP, RIGHT]:
            lane.step([action])
            assert not lane.certified()
        lane.step([DOWN])
        assert lane.certified()


# --------------------------------------------------------------------------- nearest_unknown


class TestNearestUnknown:
    def test_ties_go_up_right_down_left(self) -> None:
        middle = world("...", ".0.", "...")
        order = []
        for _ in range(4):
            (action,) = nearest_unknown(middle)
            assert action is not None
            order.append(action)
            row, col = middle.positions[0]
            near = [(row - 1, col), (row, col + 1), (row + 1, col), (row, col - 1)][action]
            middle.map_of(0)[near] = Record(True, written=0)
        assert order == [UP, RIGHT, DOWN, LEFT]
        assert nearest_unknown(middle) == [None]

    def test_the_unknown_ring_is_a_target(self) -> None:
        assert nearest_unknown(world("0")) == [UP]

    def test_nearest_dirty_where_nothing_unknown_is_left(self) -> None:
        known = world("0..", knowledge=Knowledge.MEMORISED)
        known.step([RIGHT])
        assert nearest_unknown(known) == [RIGHT]

    def test_an_occupied_cell_is_neither_target_nor_way(self) -> None:
        lane = world("01.", knowledge=Knowledge.MEMORISED)
        assert nearest_unknown(lane) == [None, RIGHT]

    def test_greedy_gives_each_target_to_one_robot(self) -> None:
        pair = world("#.#", "0.1", "###", knowledge=Knowledge.MEMORISED)
        assert nearest_unknown(pair) == [RIGHT, LEFT]
        assert assigned(pair, Assignment.GREEDY) == [(1, 1), (0, 1)]
        lane = world("0.1", knowledge=Knowledge.MEMORISED)
        assert assigned(lane, Assignment.GREEDY) == [(0, 1), None]
        assert nearest_unknown(lane, Assignment.GREEDY) == [RIGHT, LEFT]

    def test_hungarian_can_be_cheaper_than_greedy(self) -> None:
        # Dirty are (0, 0) and (0, 3): 2 and 1 steps from robot 0, 6 and 1 from robot 1.
        pair = world("..0.1", ".....", knowledge=Knowledge.MEMORISED)
        for place in [(0, 1), *((1, col) for col in range(5))]:
            pair.map_of(0)[place] = Record(False, written=0, cleaned=0)
        assert assigned(pair, Assignment.GREEDY) == [(0, 3), (0, 0)]
        assert assigned(pair, Assignment.HUNGARIAN) == [(0, 0), (0, 3)]
        assert assignment_cost(pair, [(0, 0), (0, 3)]) == (0, 3)
        assert nearest_unknown(pair, Assignment.HUNGARIAN) == [LEFT, LEFT]


# --------------------------------------------------------------------------- measures


class TestMeasures:
    def test_need_is_exact(self) -> None:
        assert [need(q, 50) for q in PER_CENTS] == [45, 48, 50, 50]
        assert need(90, 10) == 9

    def test_a_play_by_hand(self) -> None:
        # Robot 0 bumps and enters column 1; robot 1 enters column 3 and comes back.
        lane = world("0.1.", max_steps=5)
        found = measures(play(lane, [[UP, RIGHT], [RIGHT, LEFT], [UP, UP], [UP, UP]]))
        assert [found[f"T_{q}"] for q in PER_CENTS] == [2] * 4
        assert [found[f"bound_{q}"] for q in PER_CENTS] == [1] * 4
        assert found["bound_certify"] == (4 - 2 + 10) // 2
        assert found["T_certify"] is None
        assert found["coverage_auc"] == (Fraction(2, 4) + Fraction(3, 4) + 4) / 6
        assert found["return"] == Fraction("1") + Fraction("3.4") + Fraction("3.4") - 1
        assert found["redundancy"] == Fraction(5, 4) - 1
        assert (found["overlap"], found["balance"]) == (0, 0)
        assert (found["bumps"], found["collisions"]) == (1, 0)
        assert (found["contact"], found["edges"]) == (1, 1)

    def test_overlap_balance_and_collisions(self) -> None:
        found = measures(play(world("0..1"), [[RIGHT, UP], [RIGHT, LEFT], [UP, LEFT]]))
        assert (found["T_100"], found["collisions"], found["bumps"]) == (2, 1, 1)
        assert found["overlap"] == 0
        assert found["balance"] == pytest.approx(1 / 2)  # 3 and 1 cells, 1 apart from their mean
        shared_cell = measures(play(world("0.1."), [[RIGHT, UP], [LEFT, LEFT], [UP, LEFT]]))
        assert shared_cell["overlap"] == Fraction(2 + 2, 3) - 1

    def test_an_unfinished_play_holds_its_coverage_and_has_null_times(self) -> None:
        found = measures(play(world("0...", max_steps=3), [[RIGHT], [UP], [UP]]))
        assert found["T_100"] is None
        assert found["coverage"] == Fraction(2, 4)
        assert found["coverage_auc"] == (Fraction(1, 4) + 3 * Fraction(2, 4)) / 4

    def test_certify_plays_on_and_changes_no_other_measure(self) -> None:
        actions = [[a] for a in (UP, LEFT, DOWN, RIGHT, UP, RIGHT, DOWN)]
        with_certificate = measures(play(world("0."), actions, certify=True))
        without = measures(play(world("0."), actions))
        assert (with_certificate["T_certify"], without["T_certify"]) == (7, None)
        assert with_certificate | {"T_certify": None} == without
        assert without["bound_certify"] == 7

    def test_bounds_are_null_with_moving_furniture(self) -> None:
        assert set(bounds(world("0.A", "...", moves=[(1, 1, LEFT)])).values()) == {None}

    def test_ratio_to_a_bound_of_0_is_null(self) -> None:
        assert [ratio(3, 2), ratio(3, 0), ratio(None, 2)] == [Fraction(3, 2), None, None]


# --------------------------------------------------------------------------- invariants

quick = settings(max_examples=60, deadline=None)


@pytest.mark.long
@given(cases())
@quick
def test_robots_stay_on_distinct_free_cells_and_rewards_in_range(case: Case) -> None:
    played = case.world()
    for actions in case.actions:
        outcome = played.step(actions)
        assert len(set(played.positions)) == played.n_agents
        assert all(played.is_free(place) for place in played.positions)
        assert all(
            moved + bumped + collided == 1
            for moved, bumped, collided in zip(
                outcome.moved, outcome.bumped, outcome.collided, strict=True
            )
        )
        assert set(outcome.step) <= {0, -1}
        assert set(outcome.discovery) <= {0, 2, case.settings.wall_pays}
        assert all(term == 0 or 1 < term <= Fraction("2.4") for term in outcome.cleaning)
        least = -1 + min(case.settings.collision_pays, 0)
        assert all(least <= reward <= Fraction("3.4") for reward in outcome.own_reward)
        contacts = played.contacts()
        assert contacts == [list(line) for line in zip(*contacts, strict=True)]


@pytest.mark.slow
@given(cases(furniture_moves=False))
@quick
def test_coverage_never_falls_without_moving_furniture(case: Case) -> None:
    played = case.world()
    before = played.coverage()
    for actions in case.actions:
        played.step(actions)
        assert before <= played.coverage()
        before = played.coverage()


@pytest.mark.slow
@given(cases(furniture_moves=False))
@quick
def test_maps_hold_the_truth_unless_stale(case: Case) -> None:
    if case.settings.any_stale:
        case = replace(case, settings=replace(case.settings, knowledge=Knowledge.UNKNOWN))
        case = replace(case, memorised=None)
    played = case.world()
    for actions in case.actions:
        played.step(actions)
        for known in played.maps:
            assert all(record.blocked != played.is_free(place) for place, record in known.items())


@pytest.mark.long
@given(cases(furniture_moves=False))
@quick
def test_maps_merged_by_all_with_all_are_the_shared_map(case: Case) -> None:
    same = {"topology": "full", "knowledge": Knowledge.UNKNOWN, "robots_noted": False}
    readings = replace(case.settings, **same)
    case = replace(case, memorised=None)
    merged = replace(case, settings=replace(readings, memory=Memory.MERGED)).world()
    shared = replace(case, settings=replace(readings, memory=Memory.SHARED)).world()
    for actions in case.actions:
        assert merged.step(actions) == shared.step(actions)
        assert all(known == shared.maps[0] for known in merged.maps)


def planned(played: World, assignment: Assignment, seed: int) -> Iterator[list[int]]:
    """The planner's joint actions, without end; a robot with nothing to do moves at random."""
    draw = random.Random(seed)
    while True:
        actions = nearest_unknown(played, assignment)
        yield [draw.randrange(4) if action is None else action for action in actions]


@pytest.mark.long
@given(cases(max_agents=3, furniture_moves=False), st.sampled_from(Assignment), st.booleans())
@settings(max_examples=25, deadline=None)
def test_no_play_beats_a_bound(case: Case, assignment: Assignment, certify: bool) -> None:
    played = replace(case, settings=replace(case.settings, max_steps=60, stuck_after=None)).world()
    episode: Episode = play(played, planned(played, assignment, 0), certify)
    found = measures(episode)
    for name in ["certify", *PER_CENTS]:
        steps, bound = found[f"T_{name}"], found[f"bound_{name}"]
        assert steps is None or bound is None or steps >= bound
    assert 0 <= found["coverage_auc"] <= 1
    assert found["redundancy"] >= 0 and found["overlap"] >= 0
    assert found["coverage"] == 1 or found["T_100"] is None


@pytest.mark.slow
@given(cases(max_agents=2, furniture_moves=False))
@quick
def test_hungarian_costs_least_of_all_assignments(case: Case) -> None:
    played = case.world()
    for actions in case.actions[:8]:
        played.step(actions)
    found = [search(played, robot) for robot in range(played.n_agents)]
    options = [[*targets(played, robot), None] for robot in range(played.n_agents)]
    strangers = len({explores(played, robot) for robot in range(played.n_agents)}) > 1
    least = min(
        (choice.count(None), sum(found[i][p][0] for i, p in enumerate(choice) if p is not None))
        for choice in product(*options)
        if None in choice or strangers or len(set(choice)) == len(choice)
    )
    assert assignment_cost(played, assigned(played, Assignment.HUNGARIAN)) == least
    assert assignment_cost(played, assigned(played, Assignment.GREEDY)) >= least
