"""Deep Q-learning, as several learners share it."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import EGreedyModule
from torchrl.objectives import DQNLoss, HardUpdate, LossModule, SoftUpdate
from torchrl.objectives.utils import TargetNetUpdater

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.errors import BadInput
from marl_clean.learning import symmetry
from marl_clean.learning.agent import Agent, Channels, Count
from marl_clean.learning.networks import NUM_ACTIONS, noisy_parts, set_noise
from marl_clean.settings import PositiveFloat, PositiveInt, PositiveShare, Precision, Probability


class SoftUpdateAtOnce(SoftUpdate):
    """TorchRL's soft update, with one call for all weights: a tenth of its time."""

    def init_(self) -> None:
        super().init_()
        self._weights = [weight.data for weight in self._sources.values(True, True)]
        self._followers = [weight.data for weight in self._targets.values(True, True)]

    def step(self) -> None:
        torch._foreach_lerp_(self._followers, self._weights, 1 - self.eps)


class DeepQ(Agent):
    """Learn action values from replayed frames by deep Q-learning (arXiv 1312.5602, paper §2).

        y = r + gamma^k (1 - terminated) Q'(o', argmax_a Q(o', a))
        loss = Huber(Q(o, a) - y), mean over the batch

    with Q' the target network, k the steps to the next observation (`n_steps`, fewer at an
    episode's end), and the argmax taken by Q if `double` (arXiv 1509.06461), else by Q'.
    Dropout, where the encoder has it, is active in all of Q and Q' while learning. Truncated
    episodes are bootstrapped.

    Args:
        encoder, comm, channels: the network's parts; their weights are learnt in place.
        double, dueling: see above and `marl_clean.learning.networks`.
        n_steps: rewards summed before bootstrapping.
        gamma: discount of a step.
        lr, lr_end: Adam's step size, falling linearly over the run; late steps smaller, so that
            the greedy policy swings less from one evaluation to the next.
        loss: `smooth_l1` (Huber), `l2` or `l1`.
        max_grad_norm: gradients are scaled down to this norm.
        target_update: `soft` moves Q' by `tau` every update, `hard` copies Q every
            `target_period` updates.
        eps_init, eps_end, annealing_fraction: the share of random actions falls linearly from
            the one to the other over this fraction of the frames, and stays.
        precision: the encoder's arithmetic; bfloat16 is faster.
        augment: learn from each frame turned or mirrored, the same way for all its robots.
        messages: in learning, made anew by the present weights, or those that were sent; of the
            next frame they are always made anew.
        next_graph: who talks to whom in the next frame: as it was then, or as in this one.
        state_shape: of the true state, for learners that are told it.
        n_agents: robots in a world.
        num_actions: actions of a robot.
        device: where the network lives.
    """

    fits = {"trainer": ["off_policy"]}
    network_of_loss: ClassVar[str] = "value_network"  # what the loss calls it
    only_in_loss: ClassVar[Sequence[str]] = ()  # and modules beside it
    loss_keys: ClassVar[Mapping[str, NestedKey]]  # where DQNLoss finds its entries

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        double: bool,
        dueling: bool,
        n_steps: PositiveInt,
        gamma: Probability,
        lr: PositiveFloat,
        lr_end: PositiveFloat,
        loss: Literal["smooth_l1", "l2", "l1"],
        max_grad_norm: PositiveFloat,
        target_update: Literal["soft", "hard"],
        tau: PositiveShare,
        target_period: PositiveInt,
        eps_init: Probability,
        eps_end: Probability,
        annealing_fraction: Probability,
        precision: Precision,
        augment: bool,
        messages: Literal["recomputed", "replayed"] = "recomputed",
        next_graph: Literal["own", "reused"] = "own",
        channels: Channels = MappingProxyType({}),
        state_shape: torch.Size | None = None,
        n_agents: Count = 2,
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.gamma, self.n_steps = gamma, n_steps
        self.eps_init, self.eps_end, self.annealing_fraction = eps_init, eps_end, annealing_fraction
        self.lr, self.lr_end = lr, lr_end
        self.max_grad_norm = max_grad_norm
        self.augment, self.messages, self.next_graph = augment, messages, next_graph
        self.state_shape = state_shape
        self.n_agents, self.num_actions, self.device = n_agents, num_actions, device
        network = self.make_network(encoder, comm, dueling, precision, channels)
        self.network = network.to(device).eval()
        self._greedy = self.make_greedy(acting=False, records_messages=False).eval()
        if augment and self.unrolls:
            raise BadInput(
                "agent.augment=true: turns single frames, and this network learns from frames in a"
                " row; valid: false"
            )
        self._loss = self.make_loss(loss, double)
        self._loss.set_keys(**self.loss_keys)
        self._loss.make_value_estimator(gamma=gamma)
        self._target: TargetNetUpdater
        if target_update == "soft":
            self._target = SoftUpdateAtOnce(self._loss, tau=tau)
        else:  # HardUpdate copies in the update after its interval is full
            self._target = HardUpdate(self._loss, value_network_update_interval=target_period - 1)
        self._noisy = noisy_parts(self.network)
        learnt = nn.ModuleList([self.network, *self.only_in_learning()])
        self._parameters = list(learnt.parameters())
        self._optimiser = torch.optim.Adam(self._parameters, lr=lr, fused=True)
        self._coin: EGreedyModule | None = None
        self.anneal(0.0)

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        later = (*self.sees, keys.REWARD, keys.DONE, keys.TERMINATED)
        begins = (keys.IS_INIT,) if self.unrolls else ()
        said = (keys.MESSAGE,) if self.messages == "replayed" else ()
        return (*self.sees, keys.ACTION, *begins, *said, *(("next", key) for key in later))

    @property
    @abstractmethod
    def sees(self) -> Sequence[NestedKey]:
        """Where a frame holds what the network takes."""

    def measures(self) -> dict[str, float]:
        return {"epsilon": self.epsilon}

    @abstractmethod
    def make_network(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        channels: Channels,
    ) -> nn.Module:
        """Return the network from `sees` to the values of `num_actions` or their combinations."""

    @abstractmethod
    def make_greedy(self, acting: bool, records_messages: bool) -> TensorDictModuleBase:
        """Return the policy of the best actions.

        `acting`: in an env, rather than in the loss; `records_messages`: where any are sent, what
        was sent is written into the frame, too.
        """

    def make_loss(self, function: str, double: bool) -> LossModule:
        """Return TorchRL's loss, its target networks included."""
        return DQNLoss(
            self._greedy, loss_function=function, double_dqn=double, action_space="categorical"
        )

    def only_in_learning(self) -> Sequence[nn.Module]:
        """Return modules beside the network that are learnt, and that acting does without."""
        return ()

    @abstractmethod
    def for_loss(self, frames: TensorDictBase) -> None:
        """Add what the loss wants in its own shape: endings, steps, and what the learner needs."""

    def policy(self) -> TensorDictModuleBase:
        return self.make_greedy(acting=True, records_messages=True).eval()

    def coin(self, action_spec: Composite, action_key: NestedKey) -> EGreedyModule:
        """Return TorchRL's epsilon-greedy module, whose epsilon `anneal` sets.

        It explores only under TorchRL's `ExplorationType.RANDOM`, as a Collector sets it.
        """
        device = next(self.network.parameters()).device
        self._coin = EGreedyModule(action_spec, action_key=action_key, device=device)
        self._coin.eps.fill_(self.epsilon)
        return self._coin

    def anneal(self, progress: float) -> None:
        """Set epsilon (paper §3.4) and step size for a run of which `progress`, 0 to 1, is done."""
        for group in self._optimiser.param_groups:
            group["lr"] = self.lr + min(1.0, progress) * (self.lr_end - self.lr)
        annealed = min(1.0, progress / self.annealing_fraction) if self.annealing_fraction else 1.0
        self.epsilon = self.eps_init + annealed * (self.eps_end - self.eps_init)
        if self._coin is not None:  # its own step() loops over frames in Python
            self._coin.eps.fill_(self.epsilon)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one step of Adam on a batch of frames, then let the target network follow."""
        set_noise(self._noisy, True)
        frames = self._frames_to_learn(batch)
        loss = self._loss(frames)["loss"] + self.side_loss(frames)
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        self._target.step()
        set_noise(self._noisy, False)
        return {"loss": loss.detach(), "grad_norm": grad_norm}

    def _frames_to_learn(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch as the loss wants it; turned and mirrored if augmented."""
        frames = batch.select(*self.learns_from, keys.STEPS_TO_NEXT_OBS)
        if self.augment:
            now, then = frames[keys.OBSERVATION], frames["next", keys.OBSERVATION]
            (now, then), action = symmetry.turn_in_eighths([now, then], frames[keys.ACTION])
            frames[keys.OBSERVATION], frames["next", keys.OBSERVATION] = now, then
            frames[keys.ACTION] = action
        if self.next_graph == "reused":
            for key in (keys.ADJACENCY, keys.DISTANCE_RANK):
                frames["next", key] = frames[key]
        self.for_loss(frames)
        return frames

    def side_loss(self, frames: TensorDictBase) -> Tensor | float:
        """Return what is to be made small beside the temporal difference."""
        return 0.0

    def state_dict(self) -> dict[str, Any]:
        """Return weights, target weights, Adam's moments and the target's counter."""
        return {
            "network": self.network.state_dict(),
            "only_in_learning": [m.state_dict() for m in self.only_in_learning()],
            "target": self._target_weights(),
            "optimiser": self._optimiser.state_dict(),
            "target_update": self._target.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state of `state_dict`, exactly."""
        self.network.load_state_dict(state["network"])
        for module, weights in zip(
            self.only_in_learning(), state.get("only_in_learning", ()), strict=True
        ):
            module.load_state_dict(weights)
        for name, weight in self._target_weights().items():
            weight.copy_(state["target"][name])
        self._optimiser.load_state_dict(state["optimiser"])
        self._target.load_state_dict(state["target_update"])

    def _target_weights(self) -> dict[str, Tensor]:
        """Return the target network's weights by the names that the network gives its own.

        Those of what is only learnt with follow, by names of their own.
        """
        of_network = getattr(self._loss, f"target_{self.network_of_loss}_params")["network"]
        weights = {name: weight.data for name, weight in of_network.flatten_keys(".").items()}
        for module in self.only_in_loss:
            parameters = getattr(self._loss, f"target_{module}_params").flatten_keys(".")
            weights |= {f"{module}.{name}": weight.data for name, weight in parameters.items()}
        return weights
