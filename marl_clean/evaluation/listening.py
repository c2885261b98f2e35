"""Positive listening: how far robots' action values depend on the messages they hear.

A higher reward with messages does not show that robots listen (arXiv 1903.05168); so in the states
that a policy visits, the messages it hears are replaced and its action values compared, before it
acts. Only robots that hear a message are counted.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torch import Tensor, nn

from marl_clean import build, keys
from marl_clean.evaluation.evaluator import exploring, held_out_env
from marl_clean.evaluation.interventions import Shuffle, Zero, intervened
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.evaluation.statistics import estimate
from marl_clean.learning.acting import Greedy

TEMPERATURE = 1.0  # of the policies that values are turned into, in units of reward
MESSAGES = 8  # other messages, from which the influence of messages is estimated


def listening(cfg: DictConfig, policy: Greedy, count: int, epsilon: float) -> dict[str, Any]:
    """Run the untouched policy and return what replaced messages would change.

    With intervals over the held-out houses:

        moved:    mean over actions of |Q' - Q| / (max Q - min Q), Q' of a replaced message
        switched: share of states in which the best action differs
        kl:       KL(p || p'), p = softmax(Q / temperature)
        cic:      mean over k of KL(p_k || mean of p_1 ... p_K): the information, in nats, between
                  message and action, were the message drawn from those sent in that step

    The first three are for messages replaced by zeros and by another robot's, cic is over those of
    K = 8 other robots. Source: arXiv 1903.05168; there messages are symbols that can be counted,
    here they are sampled.
    """
    houses = build.held_out_houses(cfg, cfg.evaluation.house_set, count)
    env = held_out_env(cfg, houses, cfg.evaluation.house_set, count, seeded=True)
    zeros = intervened(policy, lambda dims: Zero())
    others = [intervened(policy, partial(_shuffle, k)) for k in range(1, MESSAGES + 1)]
    sums: dict[str, Tensor] = {}
    heard = torch.zeros(count, dtype=torch.float64, device=env.device)

    def compare(
        policy: nn.Module, frame: TensorDictBase, running: Bool[Tensor, " env"]
    ) -> TensorDictBase:
        hears = frame[keys.ADJACENCY].any(-1) & running[:, None]
        replaced = [other(frame.clone())[keys.ACTION_VALUE] for other in (zeros, *others)]
        frame = policy(frame)
        heard.add_(hears.sum(1))
        changes = differences_of(frame[keys.ACTION_VALUE], replaced[0], replaced[1:])
        for name, value in changes.items():
            of_houses = torch.where(hears, value, 0.0).sum(1)
            sums[name] = sums.get(name, 0.0) + of_houses
        return frame

    first, explore = first_frame(env, policy), exploring(env.base_env, epsilon)
    for _ in rollout_episodes(env, policy, first, act=compare, explore=explore):
        pass
    means = {name: (total / heard).cpu().numpy() for name, total in sums.items()}  # NaN: unheard
    return {
        "temperature": TEMPERATURE,
        "messages": MESSAGES,
        **{name: _summary(values) for name, values in means.items()},
    }


def differences_of(
    value: Float[Tensor, "env agent action"],
    zeros: Float[Tensor, "env agent action"],
    others: Sequence[Float[Tensor, "env agent action"]],
) -> dict[str, Float[Tensor, "env agent"]]:
    """How replaced messages change each robot's action values; masked actions are ignored.

    Where one action alone is allowed no message moves a choice.
    """
    differences = {}
    chance = _policy(value)
    valued = value > torch.finfo(value.dtype).min
    least = torch.where(valued, value, torch.inf).amin(-1)
    spread = (value.amax(-1) - least).clamp(min=1e-8)
    spread = torch.where(valued.sum(-1) > 1, spread, torch.inf)
    for name, other in (("zero", zeros), ("shuffle", others[0])):
        differences[f"{name}_moved"] = (other - value).abs().sum(-1) / valued.sum(-1) / spread
        differences[f"{name}_switched"] = (other.argmax(-1) != value.argmax(-1)).to(value.dtype)
        differences[f"{name}_kl"] = _divergence(chance, _policy(other))
    drawn = torch.stack([_policy(other) for other in others])
    differences["cic"] = _divergence(drawn, drawn.mean(0).expand_as(drawn)).mean(0)
    return {name: values.double() for name, values in differences.items()}


def _policy(value: Float[Tensor, "*batch action"]) -> Float[Tensor, "*batch action"]:
    return (value.double() / TEMPERATURE).softmax(-1)


def _divergence(
    p: Float[Tensor, "*batch action"], q: Float[Tensor, "*batch action"]
) -> Float[Tensor, "*batch"]:
    return (p * (p.clamp(min=1e-12) / q.clamp(min=1e-12)).log()).sum(-1)


def _shuffle(shift: int, dims: tuple[int, ...]) -> Shuffle:
    return Shuffle(shift)


def _summary(values: Float[np.ndarray, " house"]) -> dict[str, Any]:
    estimated = estimate(values[None])
    return {
        "mean": estimated.mean,
        "ci95": None if estimated.ci95 is None else list(estimated.ci95),
    }
