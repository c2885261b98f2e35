"""Where robots are, seen from each other: asked for by schemes that use places, and only then."""

import pytest
import torch

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.env.offsets import Offsets

SETTINGS = ["house=rooms", "env.num_envs=3", "env.n_agents=3", "budget=smoke"]


@pytest.mark.slow
def test_an_offset_is_what_has_to_be_added_to_get_there() -> None:
    env = build.make_env(compose_config(SETTINGS))
    assert keys.OFFSET not in env.reset().keys(True)
    env.append_transform(Offsets())
    block = env.rollout(8, break_when_any_done=False)
    for frames in (block, block["next"]):
        position, offset = frames[keys.POSITION], frames[keys.OFFSET]
        assert offset.dtype == torch.int64 and env.observation_spec[keys.OFFSET].is_in(offset[:, 0])
        for i in range(3):
            for j in range(3):
                reached = position[..., i, :] + offset[..., i, j, :]
                assert torch.equal(reached, position[..., j, :])
