"""A recording is the episode: every matrix, place, contact and message of every step."""

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.viewer import FRESH
from marl_clean.errors import BadInput
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.report.episode import first_held_out, scenes
from marl_clean.report.recorded import AVAILABLE, LEVELS, SPILT, read_recording
from marl_clean.report.recording import make_recording, record

pytestmark = pytest.mark.slow  # episodes are played

SMALL = ["house=rooms", "house.rows=[7,7]", "house.cols=[9,9]", "env.n_agents=3"]
FURNISHED = ["env.furniture_moves_per_episode=9", "env.max_steps=40", "env.decay_steps=20"]


def policy_for(settings: list[str]) -> tuple[Any, Callable]:
    cfg = compose_config([*SMALL, *settings])
    env = build.make_env(cfg)
    policy = build.make_agent(cfg, env).policy()
    return cfg, lambda env: policy


def played(changes: list[list[int]], first: str, steps: int) -> list[list[int]]:
    """The codes at every step, by the changes written down."""
    codes = [int(digit) for digit in first]
    result = [list(codes)]
    for step in range(steps):
        for cell, code in zip(changes[step][::2], changes[step][1::2], strict=True):
            codes[cell] = code
        result.append(list(codes))
    return result


SPILLING = ["env.max_steps=30", "env.spills.per_episode=5", "env.spills.noticed_within=0"]


@pytest.mark.parametrize(
    "settings", [FURNISHED, ["env.max_steps=30", "env.memory=private"], SPILLING]
)
def test_every_step_is_what_a_viewer_is_shown(settings: list[str]) -> None:
    cfg = compose_config([*SMALL, *settings])
    recording = record(first_held_out(cfg), lambda env: build.make_planner(cfg, env))
    shown = list(scenes(first_held_out(cfg), lambda env: build.make_planner(cfg, env)))
    steps = len(recording["contacts"])
    assert len(shown) == steps + 1 == len(recording["positions"])
    house = played(recording["house_changes"], recording["house"], steps)
    private = "env.memory=private" in settings
    assert len(recording["maps"]) == (3 if private else 1)
    maps = [
        played([maps[index] for maps in recording["map_changes"]], first, steps)
        for index, first in enumerate(recording["maps"])
    ]
    for step, scene in enumerate(shown):
        furniture, cleaned = scene.furniture.flatten(), scene.cleaned.flatten()
        for cell, free in enumerate(scene.free.flatten().tolist()):
            wanted = 2 + int(cleaned[cell]) if free else int(furniture[cell] > 0)
            if scene.spilt is not None and scene.spilt.flatten()[cell]:
                wanted = SPILT
            assert house[step][cell] == wanted
        places = list(zip(*[iter(recording["positions"][step])] * 2, strict=True))
        assert places == list(scene.positions)
        assert recording["coverage"][step] == pytest.approx(scene.coverage, abs=1e-4)
        if step < steps:
            pairs = list(zip(*[iter(recording["contacts"][step])] * 2, strict=True))
            assert pairs == list(scene.contacts)
        if not private:
            for cell, value in enumerate(scene.values.flatten().tolist()):
                check_code(maps[0][step][cell], value)
        else:  # a cell is known to the union of maps where it is known to any
            known = [any(held[step][cell] for held in maps) for cell in range(7 * 9)]
            assert known == (scene.values.flatten() != np.float32(-0.2)).tolist()
    assert any(recording["contacts"]) and house[0] != house[-1]
    assert any(SPILT in codes for codes in house) == (settings is SPILLING)


def check_code(code: int, value: float) -> None:
    if value < 0:
        assert code == (1 if value <= -1 else 0)
    else:
        assert abs(code - AVAILABLE - min(value / FRESH, 1.0) * LEVELS) <= 0.5 + 1e-5


@pytest.mark.long
def test_messages_are_those_that_were_sent() -> None:
    settings = ["comm=plan", "comm.message_dim=5", "env.max_steps=12"]
    cfg, policy = policy_for(settings)
    recording = record(first_held_out(cfg), policy)
    env = first_held_out(cfg)
    sent = [
        step[keys.MESSAGE][0].clone()
        for step in rollout_episodes(env, policy(env), first_frame(env, policy(env)))
    ]
    bytes_ = np.frombuffer(base64.b64decode(recording["messages"]), np.uint8)
    held = bytes_.reshape(len(sent), 3, recording["message_numbers"]).astype(float)
    numbers = (held - 128) / 127 * recording["largest"]
    wanted = np.stack([message.numpy() for message in sent])
    assert wanted.shape == (12, 3, 5) and np.abs(wanted).max() == pytest.approx(
        recording["largest"]
    )
    np.testing.assert_allclose(numbers, wanted, atol=recording["largest"] / 127)
    assert {cost for row in recording["bits"] for cost in row} <= {
        0.0,
        160.0,
        320.0,
    }  # over up to 2 edges


@pytest.mark.long
def test_who_sends_nothing_has_no_messages() -> None:
    cfg, policy = policy_for(["comm=none", "env.max_steps=5"])
    assert {"bits", "messages"}.isdisjoint(record(first_held_out(cfg), policy))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    path = tmp_path_factory.mktemp("recorded") / "replay.json"
    cfg, policy = policy_for(["comm=plan", "comm.message_dim=2", "env.max_steps=6"])
    make_recording(cfg, policy, path)
    return read_recording(path)


@pytest.mark.long
def test_what_is_written_is_read(whole: dict[str, Any]) -> None:
    assert (whole["rows"], whole["cols"]) == (7, 9)
    assert len(whole["contacts"]) == 6


DAMAGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "is no recording of schema 1": lambda r: r.update(schema=2),
    "rows": lambda r: r.update(rows="7"),
    "house: 7 x 9 cells need 63 digits": lambda r: r.update(house="0"),
    "house: codes up to 4": lambda r: r.update(house="9" * 63),
    "house: digits are valid": lambda r: r.update(house="x" * 63),
    "maps: 1 or 3 are valid": lambda r: r.update(maps=r["maps"] * 2),
    "positions: 7 are needed": lambda r: r.update(positions=r["positions"][1:]),
    "positions: a cell for each robot": lambda r: r["positions"][2].__setitem__(0, 7),
    "house_changes: pairs of a cell and its code": lambda r: r["house_changes"][1].append(3),
    "map_changes: pairs of a cell and its code": lambda r: r["map_changes"][1][0].extend([63, 1]),
    "contacts: pairs of robots below 3": lambda r: r["contacts"][0].extend([0, 3]),
    "bits: a number for each robot": lambda r: r["bits"][0].pop(),
    "messages: 36 bytes are needed": lambda r: r.update(messages="AAAA"),
    "coverage.0": lambda r: r["coverage"].__setitem__(0, "0"),
    "more": lambda r: r.update(more=1),
}


@pytest.mark.parametrize("fault", DAMAGES)
def test_a_damaged_one_is_refused(fault: str, whole: dict[str, Any], tmp_path: Path) -> None:
    damaged = json.loads(json.dumps(whole))
    DAMAGES[fault](damaged)
    path = tmp_path / "replay.json"
    path.write_text(json.dumps(damaged))
    with pytest.raises(BadInput) as refused:
        read_recording(path)
    assert fault in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, "null", '{"schema": NaN}'])
def test_what_is_none_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "replay.json"
    path.write_text(text)
    with pytest.raises(BadInput, match="replay.json: "):
        read_recording(path)
