"""Plays one episode and writes it down step by step: `replay.json`, in the format of `recorded`."""

import base64
import json
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from marl_clean import keys
from marl_clean.env.scene import scene_of
from marl_clean.env.viewer import FRESH, Scene
from marl_clean.evaluation.evaluator import PolicyFor, exploring
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.report.episode import first_held_out
from marl_clean.report.recorded import (
    AVAILABLE,
    BLOCKED,
    CLEAN,
    DIRTY,
    FURNITURE,
    LEVELS,
    SCHEMA,
    SPILT,
    UNKNOWN,
    WALL,
    Recording,
)
from marl_clean.storage import files
from marl_clean.world.rules import Rules
from marl_clean.world.shared_map import map_value
from marl_clean.world.state import State

SENT = (keys.MESSAGE, keys.MESSAGE_BITS)

Matrix = UInt8[np.ndarray, "..."]


def make_recording(
    cfg: DictConfig, policy_for: PolicyFor, path: Path, epsilon: float = 0.0
) -> None:
    """Write the episode in the first held-out house of `cfg` to `path`: that of `replay.gif`."""
    recording = record(first_held_out(cfg), policy_for, epsilon)
    text = json.dumps({"policy": cfg.name, **recording}, separators=(",", ":"), allow_nan=False)
    with files.writing(path):
        files.write_file(path, [text.encode()])


def record(env: TransformedEnv, policy_for: PolicyFor, epsilon: float = 0.0) -> Recording:
    """Play one episode of an env with a single world; returns all of a recording but `policy`."""
    policy, base = policy_for(env), env.base_env
    first = first_frame(env, policy)
    taken = Taken(base.state, base.rules)
    sent: list[TensorDictBase] = []
    for step in rollout_episodes(env, policy, first, explore=exploring(base, epsilon)):
        sent.append(step.select(keys.ADJACENCY, *SENT, strict=False).clone())
        taken.take(base.state, base.rules)
    return {
        "schema": SCHEMA,
        "rows": taken.rows,
        "cols": taken.cols,
        "n_agents": base.n_agents,
        "max_steps": int(base.state.max_steps[0]),
        **taken.as_data(),
        "contacts": [pairs(step[keys.ADJACENCY][0]) for step in sent],
        **messages_of(sent),
    }


class Taken:
    """What was seen of the world after every step: the first matrices, then their changes."""

    def __init__(self, state: State, rules: Rules) -> None:
        self.house, self.maps, scene = seen(state, rules)
        self.rows, self.cols = self.house.shape
        self.first = digits(self.house), [digits(held) for held in self.maps]
        self.house_changes: list[list[int]] = []
        self.map_changes: list[list[list[int]]] = []
        self.positions, self.coverage = [flat(scene)], [scene.coverage]

    def take(self, state: State, rules: Rules) -> None:
        """Add the world as it is now."""
        house, maps, scene = seen(state, rules)
        self.house_changes.append(changes(self.house, house))
        self.map_changes.append([changes(*pair) for pair in zip(self.maps, maps, strict=True)])
        self.house, self.maps = house, maps
        self.positions.append(flat(scene))
        self.coverage.append(scene.coverage)

    def as_data(self) -> Recording:
        house, maps = self.first
        return {
            "house": house,
            "maps": maps,
            "house_changes": self.house_changes,
            "map_changes": self.map_changes,
            "positions": self.positions,
            "coverage": [round(share, 4) for share in self.coverage],
        }


def seen(state: State, rules: Rules) -> tuple[Matrix, list[Matrix], Scene]:
    """The codes of the house and of every map in world 0, and its scene."""
    scene = scene_of(state, rules, 0)
    house = np.full(scene.free.shape, WALL, np.uint8)
    house[~scene.free & (scene.furniture > 0)] = FURNITURE
    house[scene.free] = DIRTY
    house[scene.free & scene.cleaned] = CLEAN
    if scene.spilt is not None:
        house[scene.spilt] = SPILT
    rows, cols = scene.free.shape
    inside = slice(rules.margin, rules.margin + rows), slice(rules.margin, rules.margin + cols)
    record = state.record[:1]
    now = (state.step[:1] + 1).to(record.dtype)[:, None, None, None]
    values = map_value(record, now, rules)[0].cpu().numpy()
    return house, [map_codes(held[inside]) for held in values], scene


def map_codes(values: Float[np.ndarray, "row col"]) -> Matrix:
    """Codes of a map's values: -1 blocked, -0.2 unknown, from 0 to 0.5 the cleaner, 1 a robot's."""
    fresh = np.clip(values / FRESH, 0.0, 1.0)
    codes = (AVAILABLE + np.rint(fresh * LEVELS)).astype(np.uint8)
    codes[values < 0] = UNKNOWN
    codes[values <= -1] = BLOCKED
    return codes


def digits(codes: Matrix) -> str:
    return "".join(map(str, codes.flatten().tolist()))


def changes(before: Matrix, after: Matrix) -> list[int]:
    """`[cell, code, cell, code, ...]` of the cells that are not what they were."""
    cells = np.flatnonzero(before != after)
    return np.stack([cells, after.flatten()[cells]], axis=1).flatten().tolist()


def flat(scene: Scene) -> list[int]:
    return [coordinate for place in scene.positions for coordinate in place]


def pairs(contact: torch.Tensor) -> list[int]:
    """`[i, j, i, j, ...]` of the robots in contact, i < j."""
    return contact.triu(1).nonzero().flatten().tolist()


def messages_of(sent: list[TensorDictBase]) -> Recording:
    """`bits`, `messages`, `message_numbers` and `largest`, where the policy sends any."""
    if not sent or sent[0].get(keys.MESSAGE_BITS, None) is None:
        return {}
    bits = torch.cat([step[keys.MESSAGE_BITS] for step in sent])[..., 0]
    message = torch.cat([step[keys.MESSAGE] for step in sent]).float()
    if not message.shape[-1]:
        return {}
    largest = float(message.abs().max()) or 1.0
    codes = (128 + 127 * message / largest).round().clamp(1, 255).to(torch.uint8)
    return {
        "bits": [[round(cost, 2) for cost in row] for row in bits.tolist()],
        "messages": base64.b64encode(codes.cpu().numpy().tobytes()).decode(),
        "message_numbers": message.shape[-1],
        "largest": largest,
    }
