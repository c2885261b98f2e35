"""One episode in every env, greedily: the loop of all that measures or shows a policy."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Bool, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from marl_clean.keys import ACTION, DONE, MESSAGE_BITS, MESSAGE_EDGES
from marl_clean.learning.acting import begin_carrying
from marl_clean.planner.base import Planner

Act = Callable[[nn.Module, TensorDictBase, Bool[Tensor, " env"]], TensorDictBase]
Explore = Callable[[Int[Tensor, "env agent"]], Int[Tensor, "env agent"]]


def first_frame(env: TransformedEnv, policy: nn.Module) -> TensorDictBase:
    """Reset an env and return its first frame, in which the policy carries nothing yet."""
    return begin_carrying(policy, env.reset())


def act(policy: nn.Module, td: TensorDictBase, playing: Bool[Tensor, " env"]) -> TensorDictBase:
    """Ask a network about the houses that still play only; the others get action 0.

    A planner reads its env and plans for all of them.
    """
    if isinstance(policy, Planner):
        return policy(td)
    rows = playing.nonzero()[:, 0]
    if len(rows) == len(playing):
        return policy(td)
    some = policy(td[rows])
    for key in (ACTION, MESSAGE_EDGES, MESSAGE_BITS, *_carried(policy)):
        value = some.get(key, None)  # not every policy sends messages
        if value is not None:
            whole = value.new_zeros((len(playing), *value.shape[1:]))
            td[key] = whole.index_copy_(0, rows, value)
    return td


def rollout_episodes(
    env: TransformedEnv,
    policy: nn.Module,
    first: TensorDictBase,
    *,
    ask: Act | None = None,
    explore: Explore | None = None,
    playing: Callable[[], Bool[Tensor, " env"]] | None = None,
    resets: bool = False,
) -> Iterator[TensorDictBase]:
    """Yield every step from `first` on: the frame, the action, and under "next" what came of it.

    Steps share the env's state: read what is needed before asking for the next.

    Args:
        first: what `first_frame` returned.
        ask: asks the policy for actions; without, `act` does.
        explore: replaces some actions.
        playing: which envs still play, asked before every step until none does; without, those
            whose first episode has not ended.
        resets: envs begin new episodes when one ends, for tasks that cannot be stepped beyond it.
    """
    training = policy.training
    policy.eval()
    try:
        frame, ended = first, first[DONE].flatten()
        while (still := ~ended if playing is None else playing()).any():
            # Not around the yield: what asks for the steps is not to run in these modes.
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                frame = (ask or act)(policy, frame, still)
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
    """Where a policy writes what it carries to the next step."""
    assert isinstance(policy, TensorDictModuleBase)
    return [key for key in policy.out_keys if isinstance(key, tuple) and key[0] == "next"]
