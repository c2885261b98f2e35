"""Keywords of Python mean what overrides mean, and what is wrong with them is one line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import assume, given
from hypothesis import strategies as st

from marl_clean import cli
from marl_clean.config.compose import compose_config, container
from marl_clean.errors import BadInput
from marl_clean.python.keywords import Settings, overrides_of, value_text
from marl_clean.settings import Memory
from tests.families import family

SAME: list[tuple[Settings, dict[str, Any], list[str]]] = [
    (None, {}, []),
    ("quick", {}, ["experiment=quick"]),
    (["+experiment=quick"], {"seed": 3}, ["experiment=quick", "seed=3"]),
    (None, {"experiment": "quick", "budget": "smoke"}, ["experiment=quick", "budget=smoke"]),
    (None, {"comm": "tarmac", "n_agents": 3}, ["comm=tarmac", "env.n_agents=3"]),
    (None, {"comm": "dgn", "heads": 2}, ["comm=dgn", "comm.heads=2"]),
    (None, {"gamma": 0.9, "num_envs": np.int64(8)}, ["agent.gamma=0.9", "env.num_envs=8"]),
    (None, {"lr": np.float64(1e-5)}, ["agent.lr=1e-5"]),
    (None, {"house": "apartment"}, ["house=floorplan", "house.path=apartment"]),
    (["house=apartment"], {}, ["house=floorplan", "house.path=apartment"]),
    (None, {"house": Path("a b/x.yaml")}, ["house=floorplan", "house.path='a b/x.yaml'"]),
    (None, {"rows": (4, 6), "plans": []}, ["house.rows=[4,6]", "evaluation.plans=[]"]),
    (None, {"max_steps": None, "dueling": False}, ["env.max_steps=null", "agent.dueling=false"]),
    (None, {"env.memory": Memory.MERGED}, ["env.memory=merged"]),
    (None, {"env": {"memory": "merged", "n_agents": 4}}, ["env.memory=merged", "env.n_agents=4"]),
    (None, {"evaluation": {"houses": 5}}, ["evaluation.houses=5"]),
    (
        None,
        {"channel": ["lossy", "delayed"], "channel.lossy.loss": 0.5, "steps": 2},
        ["channel=[lossy,delayed]", "channel.lossy.loss=0.5", "channel.delayed.steps=2"],
    ),
    (
        "spread",
        {"options": {"N": 2, "local_ratio": 0.5}},
        ["experiment=spread", "env.options={N:2,local_ratio:0.5}"],
    ),
]


@family(("settings", "keywords", "overrides"), SAME, fast=4)
def test_both_spellings_make_the_same_config(
    settings: Settings, keywords: dict[str, Any], overrides: Sequence[str]
) -> None:
    ours = compose_config(overrides_of(settings, keywords))
    assert container(ours) == container(compose_config(overrides))


@pytest.mark.slow
@given(st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=12))
def test_any_text_arrives_as_it_is(text: str) -> None:
    assume("${" not in text)
    [override] = OverridesParser.create().parse_overrides([f"out={value_text('out', text)}"])
    assert override.value() == text


@pytest.mark.parametrize("text", ["null", "1e3", "a\\", "it's"])
def test_a_text_stays_a_text(text: str) -> None:
    assert compose_config(overrides_of(None, {"out": text})).out == text


@pytest.mark.parametrize(
    ("settings", "keywords", "words"),
    [
        ("env.n_agents=3", {}, r"give a list, \['env.n_agents=3'\]"),
        (None, {"n_agent": 3}, "n_agent: no such key; did you mean .*env.n_agents"),
        (None, {"xyzzyq": 3}, "xyzzyq: no such key; valid: .*seed"),
        (None, {"memory": "gru"}, "memory: .* env.memory, encoder.memory"),
        (None, {"heads": 2}, "heads: no such key"),
        (None, {"n_agents": object()}, "n_agents: a object is no setting"),
        (None, {"checkpoint": "nowhere", "n_agents": 2}, "no such run"),
    ],
)
def test_bad_keywords_are_one_line(
    settings: Settings, keywords: dict[str, Any], words: str
) -> None:
    with pytest.raises(BadInput, match=words) as caught:
        overrides_of(settings, keywords)
    assert "\n" not in str(caught.value)


@family(
    ("keywords", "override"),
    [
        ({"comm": "tarmak"}, "comm=tarmak"),
        ({"house": "apartmnt"}, "house=apartmnt"),
        ({"n_agents": 0}, "env.n_agents=0"),
        ({"env.n_agent": 3}, "env.n_agent=3"),
        ({"device": "tpu"}, "device=tpu"),
    ],
    fast=2,
)
def test_what_the_command_refuses_is_refused_in_its_words(
    keywords: dict[str, Any], override: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["watch", override]) == cli.BAD_INPUT
    with pytest.raises(BadInput) as caught:
        compose_config(overrides_of(None, keywords))
    assert capsys.readouterr().err == f"marl-clean: {caught.value}\n"
