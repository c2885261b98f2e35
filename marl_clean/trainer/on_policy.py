"""The on-policy loop: collect a block, learn from it a few times, forget it."""

import math
from collections.abc import Mapping
from typing import Any, Literal, final

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from marl_clean.learning.agent import Agent
from marl_clean.logger.base import Logger
from marl_clean.settings import Collectors, PositiveInt, Probability, StatesOf
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer._frames import IN_THE_TRAINER
from marl_clean.trainer._owed import Owed
from marl_clean.trainer._share import MakeShare
from marl_clean.trainer.base import Evaluate, Trainer, TrainingLoop


@final
class OnPolicy(Trainer):
    """Train an agent from what it has just collected, in a budget of frames.

    Every block of frames: collect with exploration, estimate advantages or returns, learn from the
    block `epochs` times in minibatches drawn anew. A network that carries something from step to
    step learns from worlds' rows of the whole block, the first frame starting from what was
    carried when it was collected. All else as in `Trainer`.

    Args:
        total_frames: the run's length; a frame is one step of one world with all its robots.
        frames_per_batch: frames of a block; a multiple of the number of worlds.
        epochs: how often a block is learnt from.
        minibatch_frames: frames in one update.
        log_interval_frames, eval_interval_frames, checkpoint_interval_frames: how often.
        select_by: the measure on validation houses by which the best weights are chosen.
        curriculum_stages, curriculum_promote_at, curriculum_window_episodes: see `Curriculum`.
        imitate, imitate_frames_share: a planner that acts, and is learnt from, for this share of
            the frames at the start; null: none.
        imitate_states: planner: those that it comes to. learner: it acts less and less, and is
            learnt from in the states that the learner comes to.
        collectors: backend and number of the processes that collect.
    """

    def __init__(
        self,
        total_frames: PositiveInt,
        frames_per_batch: PositiveInt,
        epochs: PositiveInt,
        minibatch_frames: PositiveInt,
        log_interval_frames: PositiveInt,
        eval_interval_frames: PositiveInt,
        checkpoint_interval_frames: PositiveInt,
        select_by: Literal["T_90", "T_95", "T_99", "T_100", "finished", "coverage_auc", "return"],
        curriculum_stages: PositiveInt = 1,
        curriculum_promote_at: Probability = 0.9,
        curriculum_window_episodes: PositiveInt = 500,
        imitate: str | None = None,
        imitate_frames_share: Probability = 0.1,
        imitate_states: StatesOf = "planner",
        collectors: Collectors = IN_THE_TRAINER,
    ) -> None:
        self.total_frames = total_frames
        self.frames_per_batch = frames_per_batch
        self.epochs = epochs
        self.minibatch_frames = minibatch_frames
        self.log_interval_frames = log_interval_frames
        self.eval_interval_frames = eval_interval_frames
        self.checkpoint_interval_frames = checkpoint_interval_frames
        self.select_by = select_by
        self.curriculum = curriculum_stages, curriculum_promote_at, curriculum_window_episodes
        self.imitate, self.imitate_frames_share = imitate, imitate_frames_share
        self.imitate_states = imitate_states
        self.collectors = collectors

    def longest_row(self, env: EnvBase) -> tuple[str, int]:
        return "frames_per_batch", self.frames_per_batch // env.batch_size.numel()

    def begin(
        self,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: list[Logger],
        checkpoints: Checkpoints,
        make_share: MakeShare | None = None,
    ) -> "OnPolicyLoop":
        return OnPolicyLoop(self, env, agent, evaluate, loggers, checkpoints, make_share)


class OnPolicyLoop(TrainingLoop):
    """A training that remembers nothing but its last block."""

    settings: OnPolicy

    def learn(self, block: TensorDictBase) -> None:
        """Learn from the block in minibatches, `epochs` times."""
        frames = self.agent.estimate(block)
        items = frames if self.agent.unrolls else frames.flatten()
        minibatches = math.ceil(len(items) / self._size(items))
        self.make(Owed(self.settings.epochs * minibatches, items))

    def update(self, owed: Owed) -> dict[str, Tensor]:
        assert owed.items is not None
        if owed.order is None:
            owed.order = torch.randperm(len(owed.items), device=owed.items.device)
        size = self._size(owed.items)
        chosen, left = owed.order[:size], owed.order[size:]
        owed.order = left if len(left) else None
        return self.agent.update(owed.items[chosen])

    def _size(self, items: TensorDictBase) -> int:
        """Return how many of the items make a minibatch."""
        settings = self.settings
        return max(1, len(items) * settings.minibatch_frames // settings.frames_per_batch)

    def own_state(self) -> dict[str, Any]:
        return {}

    def restore_own(self, state: Mapping[str, Any]) -> None:
        pass
