"""Deep Q-learning, as several learners share it."""

import copy
from abc import abstractmethod
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import expand_as_right
from torch import Tensor, nn

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.errors import BadInput
from marl_clean.learning import acting, symmetry
from marl_clean.learning.agent import Agent, Channels, Count
from marl_clean.learning.losses import DISTANCES, margin_loss
from marl_clean.learning.networks import NUM_ACTIONS, noisy_parts, set_noise
from marl_clean.learning.schedules import Discount, Epsilon, linear, set_step_size
from marl_clean.settings import (
    PositiveFloat,
    PositiveInt,
    PositiveShare,
    Precision,
    Probability,
    RisesWith,
)


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
        gamma, gamma_end, gamma_rises_with: discount of a step, see `Discount`.
        lr, lr_end: Adam's step size, falling linearly over the run; late steps smaller, so that
            the greedy policy swings less from one evaluation to the next.
        loss: `smooth_l1` (Huber), `l2` or `l1`.
        max_grad_norm: gradients are scaled down to this norm.
        target_update: `soft` moves Q' by `tau` every update, `hard` copies Q every
            `target_period` updates.
        eps_init, eps_end, annealing_fraction: the share of random actions falls linearly from
            the one to the other over this fraction of the frames, and stays.
        precision: the encoder's arithmetic; bfloat16 is faster, on devices that have it.
        mask_walls: no action into a cell known to be blocked is considered, in targets neither.
        augment: learn from each frame rotated or mirrored, alike for all its robots.
        messages: in learning, made anew by the present weights, or those that were sent; of the
            next frame they are always made anew.
        next_graph: the edges of the next frame: its own, or those of this frame.
        state_shape: of the true state, for learners that need it.
        n_agents: robots in a world.
        num_actions: actions of a robot.
        device: where the network lives.
    """

    fits = {"trainer": ["off_policy"]}

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
        mask_walls: bool = False,
        gamma_end: Probability | None = None,
        gamma_rises_with: RisesWith = "progress",
        channels: Channels = MappingProxyType({}),
        state_shape: torch.Size | None = None,
        n_agents: Count = 2,
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.discount = Discount(gamma, gamma_end, gamma_rises_with)
        self.gamma, self.n_steps, self.state_shape = gamma, n_steps, state_shape
        self.exploring = Epsilon(eps_init, eps_end, annealing_fraction)
        self.lr, self.lr_end = lr, lr_end
        self.double, self.distance, self.max_grad_norm = double, DISTANCES[loss], max_grad_norm
        self.target_update, self.tau, self.target_period = target_update, tau, target_period
        self.augment, self.messages, self.next_graph = augment, messages, next_graph
        self.mask_walls, self.num_actions, self.device = mask_walls, num_actions, device
        self.n_agents = n_agents
        network = self.make_network(encoder, comm, dueling, precision, channels)
        self.network = network.to(device).eval()
        if augment and self.unrolls:
            raise BadInput(
                "agent.augment=true: rotates single frames, and this network learns from frames in"
                " a row; valid: false"
            )
        beside = {name: part.to(device) for name, part in self.only_in_learning().items()}
        self.learnt = nn.ModuleDict({"network": self.network, **beside})
        self.target = copy.deepcopy(self.learnt).requires_grad_(False)
        self._noisy = [*noisy_parts(self.learnt), *noisy_parts(self.target)]
        self._parameters: list[Tensor] = list(self.learnt.parameters())
        self._followers: list[Tensor] = list(self.target.parameters())
        self._updates_since_copy = 0
        self._optimiser = torch.optim.Adam(self._parameters, lr=lr, fused=True)

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        later = (*self.sees, keys.REWARD, keys.DONE, keys.TERMINATED)
        begins = (keys.IS_INIT,) if self.unrolls else ()
        sent = (keys.MESSAGE,) if self.messages == "replayed" else ()
        beside = (key for key in self.grounded_in if key not in self.sees)
        now = (*self.sees, keys.ACTION, *begins, *sent, *self.shows, *beside)
        return (*now, *(("next", key) for key in later))

    @property
    @abstractmethod
    def sees(self) -> Sequence[NestedKey]:
        """Where a frame holds what the network takes."""

    @property
    def grounded_in(self) -> Sequence[NestedKey]:
        """Where a frame holds what messages are grounded in, if they are."""
        return ()

    def measures(self) -> dict[str, float]:
        return {"epsilon": self.exploring.now, **self.moving_gamma(self.discount)}

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
    def make_greedy(self, records_messages: bool) -> TensorDictModuleBase:
        """Return the policy of the best actions.

        `records_messages`: where any are sent, what was sent is written into the frame, too.
        """

    @abstractmethod
    def values(self, network: Any, frames: TensorDictBase) -> Float[Tensor, "*batch action"]:
        """Return the values of all actions by the network, the online or the target one."""

    @abstractmethod
    def reward(self, frames: TensorDictBase) -> Float[Tensor, "*batch 1"]:
        """Return what is learnt to be expected: the rewards of the robots, or of their team."""

    def action(self, frames: TensorDictBase) -> Int[Tensor, "*batch"]:
        """Return which actions were taken, as `values` numbers them."""
        return frames[keys.ACTION]

    def shown(self, frames: TensorDictBase) -> Int[Tensor, "*batch"]:
        """Return what a planner does, numbered likewise; -1: it was not asked."""
        return frames[keys.DEMONSTRATION]

    def value_of(
        self,
        modules: nn.ModuleDict,
        value: Float[Tensor, "*batch action"],
        action: Int[Tensor, "*batch"],
        frames: TensorDictBase,
    ) -> Float[Tensor, "*batch_of_reward 1"]:
        """Return the value of these actions by modules such as `learnt`, in the reward's shape."""
        return value.gather(-1, action.unsqueeze(-1))

    def only_in_learning(self) -> dict[str, nn.Module]:
        """Make the modules beside the network that are learnt, and that acting does without."""
        return {}

    def loss(self, frames: TensorDictBase) -> Float[Tensor, ""]:
        """Return how far the values of the actions taken are from their targets.

            y = r + gamma^k (1 - terminated) Q'(o', a'),    a' = argmax over a of Q(o', a)
            loss = Huber(Q(o, a) - y), mean over the batch

        Without `double`, a' is the best by Q' itself. With a mixer, Q and Q' are the team's. Beside
        it the actions of a planner that acted are preferred by a margin, see `margin_loss`.
        """
        then, reward = frames["next"], self.reward(frames)
        values = self.values(self.learnt["network"], frames)
        value = self.value_of(self.learnt, values, self.action(frames), frames)
        with torch.no_grad():
            choosing = self.values(self.learnt["network"], then) if self.double else None
            later = self.values(self.target["network"], then)
            best = (later if choosing is None else choosing).max(-1).indices
            later = self.value_of(self.target, later, best, then)
            steps = expand_as_right(frames[keys.STEPS_TO_NEXT_OBS], reward)
            terminated = expand_as_right(then[keys.TERMINATED].squeeze(-1), reward)
            discount = torch.as_tensor(self.gamma) ** steps
            target = reward + discount * (~terminated).int() * later
        loss = self.distance(value, target, reduction="none").mean()
        return loss + margin_loss(values, self.shown(frames)) if self.demonstrated else loss

    def policy(self) -> TensorDictModuleBase:
        return self.make_greedy(records_messages=True).eval()

    def anneal(self, progress: float, finished: float = 0.0) -> None:
        """Set epsilon (paper §3.4), step size and discount for the present moment of a run."""
        self.gamma = self.discount.at(progress, finished)
        set_step_size(self._optimiser, linear(self.lr, self.lr_end, progress))
        self.exploring.anneal(progress)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one step of Adam on a batch of frames, then let the target network follow."""
        set_noise(self._noisy, True)
        frames = self._frames_to_learn(batch)
        beside, measures = self.side_loss(frames)
        loss = self.loss(frames) + beside
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        self._follow()
        set_noise(self._noisy, False)
        return {"loss": loss.detach(), "grad_norm": grad_norm, **measures}

    @torch.no_grad()
    def _follow(self) -> None:
        """Let the target network follow in place: a little, or wholly every `target_period`."""
        if self.target_update == "soft":
            torch._foreach_lerp_(self._followers, self._parameters, self.tau)
            return
        self._updates_since_copy += 1
        if self._updates_since_copy == self.target_period:
            torch._foreach_copy_(self._followers, self._parameters)
            self._updates_since_copy = 0

    def _frames_to_learn(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch as the loss wants it; rotated and mirrored if augmented."""
        frames = batch.select(*self.learns_from, keys.STEPS_TO_NEXT_OBS)
        if self.augment:
            symmetry.rotate_frames_(frames)
        if self.mask_walls:
            acting.allow_taken_(frames)
        if self.next_graph == "reused":
            for key in (key for key in keys.GRAPH if key in self.sees):
                frames["next", key] = frames[key]
        return frames

    def side_loss(self, frames: TensorDictBase) -> tuple[Tensor | float, dict[str, Tensor]]:
        """Return what is to be made small beside the temporal difference, and measures of it."""
        return 0.0, {}

    def state_dict(self) -> dict[str, Any]:
        """Return weights, target weights, Adam's moments and the target's counter."""
        return {
            "network": self.network.state_dict(),
            "only_in_learning": [m.state_dict() for m in self._beside_network()],
            "target": self._target_weights(),
            "optimiser": self._optimiser.state_dict(),
            "target_update": {"counter": self._updates_since_copy},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume exactly from a state of `state_dict`."""
        self.network.load_state_dict(state["network"])
        beside = state.get("only_in_learning", ())
        for module, weights in zip(self._beside_network(), beside, strict=True):
            module.load_state_dict(weights)
        for name, weight in self._target_weights().items():
            weight.copy_(state["target"][name])
        self._optimiser.load_state_dict(state["optimiser"])
        self._updates_since_copy = state["target_update"].get("counter", 0)

    def _beside_network(self) -> list[nn.Module]:
        return [module for name, module in self.learnt.items() if name != "network"]

    def _target_weights(self) -> dict[str, Tensor]:
        """Return the target's weights: the network's by its own names, others by their module's."""
        weights = self.target.state_dict()
        return {name.removeprefix("network."): weight for name, weight in weights.items()}
