"""What every learner offers."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.envs import Transform

from marl_clean import keys
from marl_clean.channel.base import Channel
from marl_clean.errors import BadInput
from marl_clean.learning.schedules import Discount

Count = int
"""Of robots or actions; passed by the code that builds the learner, so never a config key."""
Channels = Mapping[str, Channel]
"""What messages cross, the first nearest to the sender; handed over likewise."""


class Agent(ABC):
    """A learner that acts: a greedy policy, an exploring one, and one step of learning.

    Attributes:
        network: the module whose weights are kept, shared by both policies.
        gamma: discount of a step, the present one.
        n_steps: rewards summed before bootstrapping.
        demonstrated: frames hold what a planner does, and it is learnt from it.
    """

    network: nn.Module
    gamma: float
    n_steps: int = 1
    demonstrated: bool = False

    @property
    @abstractmethod
    def learns_from(self) -> Sequence[NestedKey]:
        """Keys of a frame that learning needs; under "next", of the frame after."""

    @property
    def shows(self) -> Sequence[NestedKey]:
        """The key under which frames hold what a planner does, if they do."""
        return (keys.DEMONSTRATION,) if self.demonstrated else ()

    @property
    def history(self) -> int:
        """How many steps gradients have to go back, since something is carried from one to the
        next that is learnt."""
        return 0

    @property
    def unrolls(self) -> bool:
        """Whether it learns from frames in a row.

        Then `update` takes `[window, time]` frames, with the first frames of episodes marked.
        """
        return self.history > 0

    def primer(self) -> Transform | None:
        """Return the transform by which episodes begin with nothing carried; None: none needed."""
        return None

    @abstractmethod
    def policy(self) -> TensorDictModuleBase:
        """Return the greedy policy; it follows the weights as they are learnt."""

    @abstractmethod
    def exploration(self, action_spec: Composite) -> TensorDictModuleBase:
        """Return the policy that collects experience; `action_spec` is the env's, all keys."""

    def demonstrated_by(
        self, planner: TensorDictModuleBase, action_spec: Composite
    ) -> TensorDictModuleBase:
        """Return the policy by which a planner collects experience, explored around as usual.

        `planner` writes its actions under `demonstration`, and over the learner's in all or a
        share of the steps; what the network carries, and says of a frame, is recorded as in
        `exploration`. With `demonstrated` the keys of `learns_from` hold the demonstration, -1
        where no planner was asked, and `update` learns it.

        Raises:
            BadInput: the learner cannot learn from a planner.
        """
        raise BadInput(
            f"trainer.imitate: {type(self).__name__} does not learn from planners; valid: null"
        )

    def measures(self) -> dict[str, float]:
        """Return numbers of the present exploration, for the log."""
        return {}

    def moving_gamma(self, discount: Discount) -> dict[str, float]:
        """Return the present discount for the log, if it moves."""
        return {} if discount.gamma_end is None else {"gamma": self.gamma}

    @abstractmethod
    def anneal(self, progress: float, finished: float = 0.0) -> None:
        """Set exploration, discount and the like for the present moment of a run.

        `progress`, from 0 to 1, of it is done; of its late episodes a share of `finished` ended
        with every cell cleaned.
        """

    def start_from_network(self) -> None:
        """Begin to learn with the weights that the network has now: a target network's, too."""
        state = self.state_dict()
        if "target" in state:
            state["target"] = {**state["target"], **state["network"]}
            self.load_state_dict(state)

    def estimate(self, block: TensorDictBase) -> TensorDictBase:
        """Return what is learnt from a block `[env, time]` that the present weights collected.

        On policy alone, once for all epochs: what `update` wants beside the frames, such as
        advantages, is added.
        """
        return block.select(*self.learns_from)

    @abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Learn from a batch of frames; return measures of it as tensors without a graph."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return all that learning resumes from, as dicts and lists of tensors and numbers."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state of `state_dict`, exactly."""
