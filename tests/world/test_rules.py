"""The rules refuse what no world can have, by the types that the config is checked against."""

import pytest

from marl_clean.config.class_source import parameters
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses
from marl_clean.house.open import Open
from marl_clean.settings import Memory, Spills
from marl_clean.world.rules import NEVER, Rules
from tests.families import family

WRONG = {
    "uncleaned_at_most": 0.5,
    "unknown_pays_as": 0.3,
    "decay_steps": 0,
    "wall_pays": 2.5,
    "shaping": -0.5,
    "collision_pays": 0.5,
    "bump_noise": 1.5,
    "stuck_after": 0,
}


@family("name", WRONG, fast=3)
def test_a_rule_out_of_range_is_refused_in_python_and_in_a_config(name: str) -> None:
    with pytest.raises(BadInput, match=f"^env.{name}: must be "):
        Rules(**{name: WRONG[name]})
    with pytest.raises(BadInput, match=f"^env.{name}: must be "):
        compose_config([f"env.{name}={WRONG[name]}"])


WRONG_SPILLS = {"per_episode": -1, "noticed_within": -2, "size": 65, "pays": -0.5}


@pytest.mark.parametrize("name", WRONG_SPILLS)
def test_a_key_of_a_section_of_rules_is_refused_by_its_whole_name(name: str) -> None:
    with pytest.raises(BadInput, match=f"^env.spills.{name}: must be .*, not {WRONG_SPILLS[name]}"):
        Rules(spills=Spills(**{name: WRONG_SPILLS[name]}))
    with pytest.raises(BadInput, match=f"^env.spills.{name}: must be .*, not {WRONG_SPILLS[name]}"):
        compose_config([f"env.spills.{name}={WRONG_SPILLS[name]}"])


@pytest.mark.slow
def test_a_section_of_rules_has_its_keys_and_no_others() -> None:
    with pytest.raises(BadInput, match="^env.spills.sizes: no such key; did you mean size?"):
        compose_config(["env.spills.sizes=3"])
    for wrong in ("3", "null", "[2]"):
        with pytest.raises(BadInput, match="^env.spills: "):
            compose_config([f"env.spills={wrong}"])
    section = compose_config(["env.spills.per_episode=2"]).env
    assert instantiate(
        section, houses=draw_houses(Open([5, 5], [5, 5]), [0], 2)
    ).rules.spills == Spills(2)


def test_without_decay_no_age_is_too_old() -> None:
    rules = Rules(decay_steps=None, uncleaned_at_most=0.499)
    assert (rules.decay_a_step, rules.dirty_after, rules.uncleaned_after) == (0, NEVER, NEVER)
    assert compose_config(["env.decay_steps=null"]).env.decay_steps is None


@pytest.mark.slow
def test_the_margin_is_handed_over_and_no_setting() -> None:
    with pytest.raises(BadInput, match="^env.margin: must be "):
        Rules(margin=0)
    with pytest.raises(BadInput, match="^env.margin: no such key"):
        compose_config(["env.margin=3"])


def test_a_config_gives_the_rules_one_key_each() -> None:
    section = compose_config(["env.memory=merged", "env.decay_steps=9"]).env
    assert "rules" not in parameters(section["_target_"])
    section["_target_"] = "marl_clean.env.cleaning.CleaningEnv"
    keys = parameters(section["_target_"])
    rules = Rules(**{name: section[name] for name in ("decay_steps", "bump_noise")})
    assert keys["memory"].annotation is Memory and not keys["memory"].required
    assert rules.decay_steps == 9


@pytest.mark.slow
def test_instantiate_gathers_keys_and_parts_into_the_record() -> None:
    cfg = compose_config(["env.memory=merged", "env.num_envs=3", "house=open"])
    houses = draw_houses(instantiate(cfg.house), [0], 2)
    env = instantiate(
        cfg.env, houses=houses, margin=4, stuck_after=None, contact=lambda state, rules: None
    )
    assert env.rules == Rules(memory=Memory.MERGED, margin=4, stuck_after=None)
    assert env.num_envs == 3
