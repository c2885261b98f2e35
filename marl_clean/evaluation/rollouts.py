"""One greedy episode in every env: the loop behind all measures and pictures of a policy."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Bool, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from marl_clean.keys import ACTION, DONE, MESSAGE_BITS, MESSAGE_EDGES
from marl_clean.learning.acting import OF_TOLD, begin_carrying
from marl_clean.planner.base import Planner

Act = Callable[[nn.Module, TensorDictBase, Bool[Tensor, " env"]], TensorDictBase]
Explore = Callable[[Int[Tensor, "env agent"]], Int[Tensor, "env agent"]]


def first_frame(env: TransformedEnv, policy: nn.Module) -> TensorDictBase:
    """Reset an env and return its first frame, with the policy's carried state at zero."""
    return begin_carrying(policy, env.reset())


def act_in_running(
    policy: nn.Module, td: TensorDictBase, running: Bool[Tensor, " env"]
) -> TensorDictBase:
    """Let a network act in the envs whose episode is running; the others get action 0.

    A planner reads its env and plans for all of them.
    """
    if isinstance(policy, Planner):
        return policy(td)
    rows = running.nonzero()[:, 0]
    if len(rows) == len(running):
        return policy(td)
    some = policy(td[rows])
    for key in (ACTION, MESSAGE_EDGES, MESSAGE_BITS, *OF_TOLD, *_carried(policy)):
        value = some.get(key, None)  # not every policy sends messages
        if value is not None:
            whole = value.new_zeros((len(running), *value.shape[1:]))
            td[key] = whole.index_copy_(0, rows, value)
    return td


def rollout_episodes(
    env: TransformedEnv,
    policy: nn.Module,
    first: TensorDictBase,
    *,
    act: Act | None = None,
    explore: Explore | None = None,
    running: Callable[[], Bool[Tensor, " env"]] | None = None,
    resets: bool = False,
) -> Iterator[TensorDictBase]:
    """Yield every step from `first` on: the frame, the action, and the next frame under "next".

    Steps share the env's state: read it before the next step is requested.

    Args:
        first: what `first_frame` returned.
        act: calls the policy; None: `act_in_running`.
        explore: replaces some actions.
        running: returns which envs are still running, called before every step until none is;
            None: those whose first episode has not ended.
        resets: whether envs begin new episodes, for tasks that cannot be stepped beyond an end.
    """
    training = policy.training
    policy.eval()
    try:
        frame, ended = first, first[DONE].flatten()
        while (still := ~ended if running is None else running()).any():
            # Not around the yield: the caller's code must not run in these modes.
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                frame = (act or act_in_running)(policy, frame, still)
                if explore is not None:
                    frame[ACTION] = explore(frame[ACTION])
                frame = env.step(frame)
            yield frame
            ended = ended | frame["next", DONE].flatten()
            frame = step_mdp(frame)
            if resets:
                frame = env.maybe_reset(frame)
    finally:
        policy.train(training)


def _carried(policy: nn.Module) -> list[NestedKey]:
    """The keys of what a policy carries to the next step."""
    assert isinstance(policy, TensorDictModuleBase)
    return [key for key in policy.out_keys if isinstance(key, tuple) and key[0] == "next"]
