"""The off-policy loop: collect, remember, learn; and now and then log, evaluate, save."""

from collections.abc import Mapping
from typing import Any, Literal, final

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import EnvBase

from marl_clean import keys
from marl_clean.learning.agent import Agent
from marl_clean.logger.base import Logger
from marl_clean.settings import (
    BufferFrames,
    Collectors,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Probability,
    StatesOf,
)
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer._collecting import Rows, Windows, replay_state, restore_replay
from marl_clean.trainer._frames import IN_THE_TRAINER
from marl_clean.trainer._owed import Owed
from marl_clean.trainer._share import MakeShare
from marl_clean.trainer.base import Evaluate, Trainer, TrainingLoop


@final
class OffPolicy(Trainer):
    """Train an agent from replayed experience, in a budget of frames.

    Every block of frames: collect with exploration, close the n-step windows, remember them, learn
    from `replay_ratio` remembered frames for every new one. All else as in `Trainer`.

    Args:
        total_frames: the run's length; a frame is one step of one world with all its robots.
        frames_per_batch: frames collected between learning; a multiple of the number of worlds.
        buffer_frames: frames remembered.
        batch_frames: frames in one update.
        replay_ratio: frames learnt from for each new one.
        start_frames: frames collected before the first update.
        log_interval_frames, eval_interval_frames, checkpoint_interval_frames: how often.
        window_frames: frames in a row of one world that a network learns from together which
            carries something from step to step: a memory, or messages under way. Its first frame
            starts from what was carried when it was collected, and gradients cross the others.
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
        buffer_frames: BufferFrames,
        batch_frames: PositiveInt,
        replay_ratio: PositiveFloat,
        start_frames: NonNegativeInt,
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
        window_frames: PositiveInt = 8,
    ) -> None:
        self.total_frames = total_frames
        self.frames_per_batch = frames_per_batch
        self.buffer_frames = buffer_frames
        self.batch_frames = batch_frames
        self.replay_ratio = replay_ratio
        self.start_frames = start_frames
        self.log_interval_frames = log_interval_frames
        self.eval_interval_frames = eval_interval_frames
        self.checkpoint_interval_frames = checkpoint_interval_frames
        self.select_by = select_by
        self.window_frames = window_frames
        self.curriculum = curriculum_stages, curriculum_promote_at, curriculum_window_episodes
        self.imitate, self.imitate_frames_share = imitate, imitate_frames_share
        self.imitate_states = imitate_states
        self.collectors = collectors

    def longest_row(self, env: EnvBase) -> tuple[str, int]:
        return "window_frames", self.window_frames

    def begin(
        self,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: list[Logger],
        checkpoints: Checkpoints,
        make_share: MakeShare | None = None,
    ) -> "OffPolicyLoop":
        return OffPolicyLoop(self, env, agent, evaluate, loggers, checkpoints, make_share)


class OffPolicyLoop(TrainingLoop):
    """A training with its replay."""

    settings: OffPolicy

    def __init__(
        self,
        settings: OffPolicy,
        env: EnvBase,
        agent: Agent,
        evaluate: Evaluate,
        loggers: list[Logger],
        checkpoints: Checkpoints,
        make_share: MakeShare | None = None,
    ) -> None:
        super().__init__(settings, env, agent, evaluate, loggers, checkpoints, make_share)
        self.windows = Windows(agent.n_steps, agent.gamma)
        self.rows = Rows(settings.window_frames) if agent.unrolls else None
        together = 1 if self.rows is None else settings.window_frames
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(settings.buffer_frames // together, device=env.device),
            batch_size=settings.batch_frames // together,
        )

    def learn(self, block: TensorDictBase) -> None:
        """Remember what can be learnt from; learn as often as the frames since the start allow."""
        self.windows.gamma = self.agent.gamma
        ready = self.windows.inv(block.select(*self.agent.learns_from))
        if ready is not None:
            ready = ready.select(*self.agent.learns_from, keys.STEPS_TO_NEXT_OBS)
            for items in [ready.flatten()] if self.rows is None else self.rows.full(ready):
                self.replay.extend(items)
        settings = self.settings
        learnable = max(0, self.frames - settings.start_frames) * settings.replay_ratio
        owed = int(learnable / settings.batch_frames) - self.updates
        if not len(self.replay) or owed <= 0:
            return
        self.make(Owed(owed))

    def update(self, owed: Owed) -> dict[str, Tensor]:
        return self.agent.update(self.replay.sample())

    def own_state(self) -> dict[str, Any]:
        return {
            "windows": self.windows.state(),
            "rows": None if self.rows is None else self.rows.open,
            "replay": replay_state(self.replay),
        }

    def restore_own(self, state: Mapping[str, Any]) -> None:
        device = self.env.device
        if self.env.base_env.resumes_exactly:
            windows, rows = state["windows"], state.get("rows")
            self.windows.restore(None if windows is None else windows.to(device))
            if self.rows is not None and rows is not None:
                self.rows.open = rows.to(device)
        restore_replay(self.replay, state["replay"])
