"""What robots of a team know, see and are paid for beside the paper's rules, by hand."""

from dataclasses import replace

import pytest
import torch
from omegaconf import OmegaConf

from marl_clean import keys
from marl_clean.build import make_env
from marl_clean.commands.checks import check_all, check_teams
from marl_clean.config.class_source import parameters
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import read_level, rooms
from marl_clean.config.stored import compose_for_policy
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.rooms import Rooms
from marl_clean.settings import Knowledge, Memory, PaidBy
from marl_clean.topology.full import Full
from marl_clean.topology.none import Nobody
from marl_clean.world import dynamics
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import MEMORISED_BLOCKED, MEMORISED_FREE
from tests.families import family
from tests.world.play import houses_of

UP, RIGHT, DOWN, LEFT = range(4)
HOUSES = draw_houses(Rooms([7, 9], [6, 9]), range(12), n_agents=3)
PRIVATE = Rules(memory=Memory.PRIVATE, stuck_after=None)
LANE = houses_of([[True] * 4], None, [(0, 0), (0, 3)])


def lane(rules: Rules, contact=None) -> CleaningEnv:
    """Two robots at the ends of a lane of four cells."""
    contact = Nobody().contact if contact is None else contact
    env = CleaningEnv(LANE, rules, n_agents=2, num_envs=1, contact=contact)
    env.reset()
    return env


def earned(env: CleaningEnv, *actions: int) -> list[float]:
    after = env.step_worlds(torch.tensor([actions]))
    return [round(each, 4) for each in after[keys.OWN_REWARD].flatten().tolist()]


@pytest.mark.parametrize(
    ("paid_by", "entering", "bumping"),
    [(PaidBy.OWN_MAP, 3.4, 1.0), (PaidBy.TEAM_MAP, -1.0, -1.0)],
)
def test_what_a_teammate_has_done_pays_nobody_again(paid_by, entering, bumping) -> None:
    env = lane(replace(PRIVATE, paid_by=paid_by))
    assert earned(env, RIGHT, UP) == [3.4, 1.0]
    assert earned(env, UP, LEFT) == [1.0, 3.4]
    assert earned(env, LEFT, UP) == [-1.0, 1.0]
    assert earned(env, DOWN, LEFT) == [1.0, entering]  # where robot 0 was at step 1
    assert earned(env, DOWN, UP) == [-1.0, bumping]  # the wall that it met at step 2


def test_only_the_cells_asked_for_are_united(monkeypatch: pytest.MonkeyPatch) -> None:
    shapes = []
    united = dynamics.union_of_maps
    monkeypatch.setattr(
        dynamics, "union_of_maps", lambda record: shapes.append(record.shape) or united(record)
    )
    for memory in Memory:
        for paid_by in PaidBy:
            earned(lane(Rules(memory=memory, paid_by=paid_by)), RIGHT, LEFT)
    assert shapes == [(1, 2, 2)] * 2  # under private and merged maps, world, map, robot


def test_a_collision_is_a_term_of_its_own() -> None:
    houses = houses_of([[True, True]] * 2, None, [(0, 0), (0, 1)])
    env = CleaningEnv(houses, Rules(collision_pays=-0.75), n_agents=2, num_envs=1)
    first = env.reset()
    assert first[keys.INFO_COLLISION].flatten().tolist() == [0, 0]
    assert keys.INFO_COLLISION in env.observation_keys
    after = env.step_worlds(torch.tensor([[RIGHT, UP]]))
    assert after[keys.INFO_COLLISION].flatten().tolist() == [-0.75, 0]
    assert after[keys.INFO_STEP].flatten().tolist() == [-1, -1]
    assert after[keys.OWN_REWARD].flatten().tolist() == [-1.75, 1]
    assert after[keys.REWARD].flatten().tolist() == [-1.75, 1]
    plain = CleaningEnv(houses, n_agents=2, num_envs=1)
    assert keys.INFO_COLLISION not in plain.reset().keys(True, True)
    assert keys.INFO_COLLISION not in plain.observation_keys


def knowing(*kinds: Knowledge, memory: Memory = Memory.PRIVATE, moves: int = 6) -> CleaningEnv:
    rules = Rules(memory=memory, knowledge=list(kinds))
    before = moves if Knowledge.STALE in kinds else 0
    env = CleaningEnv(
        HOUSES,
        rules,
        n_agents=len(kinds),
        num_envs=24,
        furniture_moves_before_start=before,
        contact=Full().contact,
    )
    env.reset()
    return env


def assert_knows(env: CleaningEnv, robot: int, blocked: torch.Tensor) -> None:
    """Robot's map is this layout, its own cell apart, and nothing outside house and ring."""
    state, margin = env.state, env.rules.margin
    for world in range(env.num_envs):
        rows, cols = int(state.rows[world]), int(state.cols[world])
        record = state.record[world, robot].clone()
        row, col = state.position[world, robot].tolist()
        assert record[row + margin, col + margin] == 1
        record[row + margin, col + margin] = MEMORISED_FREE
        ring = slice(margin - 1, margin + rows + 1), slice(margin - 1, margin + cols + 1)
        expected = torch.where(blocked[world][ring], MEMORISED_BLOCKED, MEMORISED_FREE)
        own = row + 1, col + 1  # free now, whatever the layout was
        expected[own] = MEMORISED_FREE
        assert torch.equal(record[ring], expected)
        record[ring] = 0
        assert not record.any()


def test_each_robot_begins_with_what_it_knows() -> None:
    env = knowing(Knowledge.MEMORISED, Knowledge.UNKNOWN, Knowledge.STALE)
    state = env.state
    before = env.setup.houses.blocked[state.house]
    assert (before != state.blocked).any()
    assert_knows(env, 0, state.blocked)
    assert_knows(env, 2, before)
    assert (state.record[:, 1] != 0).sum((1, 2)).eq(1).all()  # its own cell


@pytest.mark.slow
def test_a_list_of_one_kind_is_that_kind_alone() -> None:
    for kind in Knowledge:
        listed = knowing(kind, kind)
        single = CleaningEnv(
            HOUSES,
            replace(listed.rules, knowledge=kind),
            n_agents=2,
            num_envs=24,
            furniture_moves_before_start=listed.setup.furniture.before_start,
            contact=Full().contact,
        )
        single.reset()
        for name, tensor in single.state.tensors().items():
            assert torch.equal(tensor, listed.state.tensors()[name]), name


def test_a_guide_tells_whom_it_meets() -> None:
    env = knowing(Knowledge.MEMORISED, Knowledge.UNKNOWN, memory=Memory.MERGED)
    assert torch.equal(env.state.record[:, 0], env.state.record[:, 1])
    assert (env.state.record[:, 1] == MEMORISED_FREE).any()


def observed(level: str, *overrides: str) -> torch.Tensor:
    target = read_level("observation", level)["_target_"]
    small = ["observation.view_size=5"] if "view_size" in parameters(target) else []
    settings = [f"observation={level}", *small, "env.n_agents=3", "env.stuck_after=9", *overrides]
    env = make_env(compose_config([*settings, "env.memory=private"]), HOUSES, num_envs=6)
    generator = torch.Generator().manual_seed(2)
    frame, seen = env.reset(), []
    for _ in range(25):
        seen.append(frame[keys.OBSERVATION])
        frame[keys.ACTION] = torch.randint(4, (6, 3), generator=generator)
        _, frame = env.step_and_maybe_reset(frame)
    return torch.stack(seen)


@pytest.mark.long
@family("level", rooms()["observation"], fast=3)
def test_robots_in_contact_that_are_not_shown_are_seen_as_those_out_of_contact(level: str) -> None:
    hidden = observed(level, "topology=full", "env.robots_shown=false")
    assert torch.equal(hidden, observed(level, "topology=none"))
    if level != "distances":
        assert not torch.equal(hidden, observed(level, "topology=full"))


@pytest.mark.slow
def test_on_a_shared_map_a_robot_not_shown_leaves_a_cell_just_cleaned() -> None:
    for shown, expected in ((True, 1.0), (False, 0.5)):
        settings = ["env.n_agents=2", f"env.robots_shown={shown}", "observation.view_size=7"]
        env = make_env(compose_config(settings), LANE, num_envs=1)
        view = env.reset()[keys.OBSERVATION][0, :, 0]
        assert view[0, 3, 3] == view[1, 3, 3] == 1
        assert view[0, 3, 6] == view[1, 3, 0] == pytest.approx(expected)


WRONG = {
    "env.knowledge=[memorised,unknown]": r"one map for all .*=private or merged.*; valid: unknown",
    "env.knowledge=[memorised,unknown] env.memory=private env.n_agents=3": (
        "has 2 entries for env.n_agents=3; .*; valid: unknown, memorised, stale"
    ),
    "env.knowledge=[] env.memory=private": "has 0 entries for env.n_agents=2",
    "env.knowledge=[known,unknown] env.memory=private": "must be one of unknown, memorised, stale",
    "env.knowledge=[memorised,unknown] env.memory=merged evaluation.team_sizes=[2,4]": (
        r"evaluation.team_sizes: 4: env.knowledge=\[memorised, unknown\]: has 2 entries"
    ),
    "env.paid_by=team": "own_map, team_map, .*did you mean team_map",
    "env.robots_shown=maybe": "must be true or false",
    "env.robots_noted=true": "maps are shared; valid with env.memory=private",
    "env.robots_noted=true env.robots_shown=false": "nobody is seen; valid with env.robots_shown=",
    "env.collision_pays=1": "must be a number, at most 0, not 1",
    "env.collision_pays=-.inf": "must be a number, at most 0",
}


@family("settings", WRONG, fast=4)
def test_bad_input_is_refused_in_a_line(settings: str) -> None:
    with pytest.raises(BadInput, match=WRONG[settings]) as refused:
        config = compose_config(settings.split())
        check_all(config)
        check_teams(config)
    assert "\n" not in str(refused.value)


def test_an_env_refuses_a_list_of_another_length() -> None:
    rules = replace(PRIVATE, knowledge=[Knowledge.MEMORISED])
    with pytest.raises(BadInput, match=r"env.knowledge=\[memorised\]: has 1 entries"):
        CleaningEnv(HOUSES, rules, n_agents=2, num_envs=1, contact=Full().contact)


@pytest.mark.slow
def test_a_team_of_another_size_is_refused_for_a_checkpoint_with_a_list(tmp_path) -> None:
    settings = ["env.memory=private", "env.knowledge=[memorised,unknown]"]
    config = compose_config(settings)
    (tmp_path / "config.yaml").write_text(OmegaConf.to_yaml(config, resolve=True))
    chosen = [f"checkpoint={tmp_path}"]
    check_all(compose_for_policy(chosen))
    with pytest.raises(BadInput, match=r"has 2 entries for env.n_agents=4") as refused:
        check_all(compose_for_policy([*chosen, "env.n_agents=4"]))
    assert "\n" not in str(refused.value)
    check_all(compose_for_policy([*chosen, "env.n_agents=4", "env.knowledge=memorised"]))


@pytest.mark.slow
def test_runs_from_before_these_keys_keep_their_hash() -> None:
    config = compose_config()
    before = OmegaConf.create(OmegaConf.to_container(config))
    for key in ("paid_by", "collision_pays", "robots_shown", "robots_noted"):
        del before.env[key]
    assert config_hash(before) == config_hash(config)
    for change in (
        ["env.paid_by=team_map"],
        ["env.collision_pays=-1"],
        ["env.robots_shown=false"],
        ["env.memory=private", "env.robots_noted=true"],
        ["env.memory=private", "env.knowledge=[memorised,unknown]"],
    ):
        assert config_hash(compose_config(change)) != config_hash(config)
