"""Proximal policy optimisation, as several learners share it."""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer
from torchrl.objectives import MAPPOLoss
from torchrl.objectives.value import GAE

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.learning import acting, grounding
from marl_clean.learning.acting import Greedy, Logits
from marl_clean.learning.agent import Agent, Channels, Count
from marl_clean.learning.critic import Critic, Knows, Values
from marl_clean.learning.losses import cross_entropy
from marl_clean.learning.networks import NUM_ACTIONS, RobotsNetwork, noisy_parts, set_noise
from marl_clean.learning.schedules import Discount, linear, set_step_size
from marl_clean.settings import (
    NonNegativeFloat,
    Play,
    PositiveFloat,
    PositiveShare,
    Precision,
    Probability,
    Recurrence,
    RisesWith,
)

DONE, TERMINATED = (keys.AGENTS, keys.DONE), (keys.AGENTS, keys.TERMINATED)
MEASURED = ("loss_critic", "entropy", "kl_approx", "clip_fraction", "imitation")


class Ppo(Agent):
    """Learn a policy that draws its actions, by clipped steps (arXiv 1707.06347).

        A_i by generalised advantage estimation over r_i and the critic's V (arXiv 1506.02438)
        ratio_i = pi(a_i | o) / pi_old(a_i | o)
        loss = -mean min(ratio A, clip(ratio, 1 - clip_epsilon, 1 + clip_epsilon) A)
               + critic_coeff (V - return)^2 or Huber - entropy_coeff entropy

    Truncated episodes are bootstrapped, terminated ones are not. All robots share the weights;
    messages are made anew in the loss, so gradients cross live edges. The critic is for learning
    alone. The value of a frame's successor is taken from the following frame of the block, so that
    the critic evaluates each frame once before the epochs.

    What draws while it learns (dropout, dial's noise, ic3net's gate) does not while it collects, so
    ratios differ from 1 even in the first step on a block.

    Args:
        encoder, comm, channels: the policy's parts; the critic gets an encoder of the same kind.
        gamma, gamma_end, gamma_rises_with: discount of a step, see `Discount`; without an end it
            is constant.
        lmbda: of the advantages: 0 trusts the critic, 1 the returns.
        clip_epsilon: how far a ratio may move.
        entropy_coeff, entropy_coeff_end: weight of the entropy bonus, which goes linearly from the
            one to the other over the run; null: it is constant.
        critic_coeff: weight of the critic's loss.
        critic_loss: `smooth_l1` (Huber), `l2` or `l1`.
        normalize_advantage: to mean 0 and deviation 1 in each minibatch.
        lr, lr_end: Adam's step size, falling linearly over the run.
        max_grad_norm: gradients are scaled down to this norm.
        precision: the encoders' arithmetic; bfloat16 is faster, on devices that have it.
        mask_walls: no action into a cell known to be blocked is considered.
        zero_head: the policy's last layer begins with zeros, so that all actions are as likely.
        play: measured and watched is the most likely action, or one drawn by what frames hold for
            channels to draw by: a pure function of seed, env, episode, step and robot.
        critic: what the critic knows, see `Critic`; null: as the level says.
        critic_memory: `gru`: the critic remembers, whether or not the policy does.
        normalize_value: the critic's values and their targets, by their running mean and deviation.
        state_shape: of the true state, for a critic that knows it.
        n_agents: robots in a world.
        num_actions: actions of a robot.
        device: where the networks live.
    """

    fits = {"trainer": ["on_policy"]}
    knows: ClassVar[Knows]  # what the critic knows where `critic` does not say it
    loss_class: ClassVar[type[MAPPOLoss]]

    network: RobotsNetwork

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        gamma: Probability,
        lmbda: Probability,
        clip_epsilon: PositiveShare,
        entropy_coeff: NonNegativeFloat,
        critic_coeff: PositiveFloat,
        critic_loss: Literal["smooth_l1", "l2", "l1"],
        normalize_advantage: bool,
        lr: PositiveFloat,
        lr_end: PositiveFloat,
        max_grad_norm: PositiveFloat,
        precision: Precision,
        channels: Channels,
        mask_walls: bool = False,
        entropy_coeff_end: NonNegativeFloat | None = None,
        zero_head: bool = False,
        play: Play = "argmax",
        critic: Literal["local", "robots", "state"] | None = None,
        critic_memory: Recurrence = "none",
        normalize_value: bool = False,
        gamma_end: Probability | None = None,
        gamma_rises_with: RisesWith = "progress",
        state_shape: torch.Size | None = None,
        n_agents: Count = 2,
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.discount = Discount(gamma, gamma_end, gamma_rises_with)
        self.gamma, self.lr, self.lr_end = gamma, lr, lr_end
        self.max_grad_norm = max_grad_norm
        self.n_agents = n_agents
        self.play = play
        self.entropy_coeff = entropy_coeff
        self.entropy_coeff_end = entropy_coeff if entropy_coeff_end is None else entropy_coeff_end
        knows = self.knows if critic is None else critic
        valuing = Critic(encoder, knows, precision, critic_memory, state_shape, normalize_value)
        network = RobotsNetwork(encoder, comm, num_actions, precision, channels, mask_walls)
        if zero_head:
            for weight in network.head.parameters():
                nn.init.zeros_(weight)
        self.network, self.critic = network.to(device).eval(), valuing.to(device).eval()
        self._critic_hidden: Tensor | None = None  # its memory behind the last block
        self._loss = self.loss_class(
            acting.drawing(self.network, acting=False),
            Values(self.critic),
            clip_epsilon=clip_epsilon,
            entropy_coeff=entropy_coeff,
            critic_coeff=critic_coeff,
            loss_critic_type=critic_loss,
            normalize_advantage=normalize_advantage,
            value_norm=self.critic.norm,
        )
        self._advantages = GAE(gamma=gamma, lmbda=lmbda, value_network=None)
        of_values = {
            "advantage": keys.ADVANTAGE,
            "value_target": keys.VALUE_TARGET,
            "value": keys.STATE_VALUE,
            "reward": keys.REWARD,
            "done": DONE,
            "terminated": TERMINATED,
        }
        self._advantages.set_keys(**of_values)
        self._loss.set_keys(action=keys.ACTION, sample_log_prob=keys.LOG_PROB, **of_values)
        self._noisy = noisy_parts(self.network)
        self.grounding = grounding.grounding_of(self.network.comm, device)
        learnt = (self.network, self.critic, *filter(None, [self.grounding]))
        self._parameters = [weight for module in learnt for weight in module.parameters()]
        self._optimiser = torch.optim.Adam(self._parameters, lr=lr, fused=True)

    @property
    def history(self) -> int:
        return max(self.network.history, int(self.critic.memory is not None))

    def primer(self) -> TensorDictPrimer | None:
        network = self.network
        return acting.primer(network, self.n_agents) if network.carries else None

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        later = (*self.critic.sees, keys.REWARD, keys.DONE, keys.TERMINATED)
        begins = (keys.IS_INIT,) if self.unrolls else ()
        of_critic = (key for key in self.critic.sees if key not in self.network.sees)
        grounded_in = () if self.grounding is None else self.grounding.sees
        beside = (*of_critic, *(key for key in grounded_in if key not in self.network.sees))
        now = (*self.network.sees, *beside, keys.ACTION, keys.LOG_PROB, *begins, *self.shows)
        return (*now, *(("next", key) for key in later))

    def policy(self) -> Greedy:
        return Greedy(self.network, self.n_agents, True, draws=self.play == "sampled").eval()

    def exploration(self, action_spec: Composite) -> TensorDictModuleBase:
        """Return the policy that draws; it draws under TorchRL's `ExplorationType.RANDOM`."""
        return acting.drawing(self.network, acting=True)

    def demonstrated_by(
        self, planner: TensorDictModuleBase, action_spec: Composite
    ) -> TensorDictModuleBase:
        """Return the policy by which a planner acts; its actions are not explored around."""
        return TensorDictSequential(acting.drawing(self.network, acting=True), planner)

    def measures(self) -> dict[str, float]:
        return self.moving_gamma(self.discount)

    def anneal(self, progress: float, finished: float = 0.0) -> None:
        """Set step size, entropy bonus and discount by a run's progress."""
        self.gamma = self.discount.at(progress, finished)
        self._advantages.gamma.fill_(self.gamma)
        set_step_size(self._optimiser, linear(self.lr, self.lr_end, progress))
        entropy = linear(self.entropy_coeff, self.entropy_coeff_end, progress)
        self._loss.entropy_coeff.fill_(entropy)

    def estimate(self, block: TensorDictBase) -> TensorDictBase:
        """Return what is learnt from a block `[env, time]`: advantages and returns added.

        What a planner does is kept of a block in which it acted alone.
        """
        frames = block.select(*self.learns_from)
        if self.demonstrated and not (frames[keys.DEMONSTRATION] >= 0).any():
            frames = frames.exclude(keys.DEMONSTRATION)
        acting.give_robots_endings(frames)
        if self.network.mask_walls:
            acting.allow_taken_(frames)
        with torch.no_grad():  # GAE itself would call the critic under vmap, which convolutions
            self._value_(frames)  # with channels last do not go through
            self._advantages(frames)
        return frames.exclude("next", keys.STATE_VALUE)

    def _value_(self, frames: TensorDictBase) -> None:
        """Value frames `[env, time]` and their next frames, in place.

        A frame's next frame is the following one, except at the ends of episodes and the block. A
        critic's memory continues from the previous block.
        """
        critic, last = self.critic, acting.last_frames(frames)
        behind = frames["next"][last]
        feature = critic.features(*(behind[key] for key in critic.sees))
        if critic.memory is None:
            value = critic(*(frames[key] for key in critic.sees))
        else:
            hidden = nothing = critic.no_memory(frames)
            if self._critic_hidden is not None and self._critic_hidden.shape == nothing.shape:
                hidden = self._critic_hidden
            value, before, after = critic.unroll(frames, hidden)
            feature = critic.remember(feature, after[last])
            frames[keys.CRITIC_HIDDEN], self._critic_hidden = before, after[:, -1]
        later = value.roll(-1, dims=1)
        later[last] = critic.value(feature)
        frames[keys.STATE_VALUE], frames["next", keys.STATE_VALUE] = value, later

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one step of Adam on a minibatch: frames, or rows `[env, time]` if it unrolls."""
        set_noise(self._noisy, True)
        shown = keys.DEMONSTRATION in batch.keys(True)
        losses = self.imitation(batch) if shown else self._loss(batch)
        grounded, of_grounding = grounding.ground_loss(self.grounding, self.network, batch)
        loss = losses["loss_objective"] + losses["loss_entropy"] + losses["loss_critic"] + grounded
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        set_noise(self._noisy, False)
        measures = {name: losses[name].detach() for name in MEASURED if name in losses.keys()}
        return {"loss": loss.detach(), "grad_norm": grad_norm, **measures, **of_grounding}

    def imitation(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the losses where a planner acted: its actions are learnt, and their returns.

        -log pi(a_planner | o) + critic_coeff (V - return)^2 or Huber
        """
        logits = Logits(self.network, acting=False)(batch.copy())[keys.LOGITS]
        critic, *_ = self._loss.loss_critic(batch.copy())
        shown = cross_entropy(logits, batch[keys.DEMONSTRATION])
        nothing = torch.zeros_like(shown)
        return TensorDict(
            loss_objective=shown, loss_entropy=nothing, loss_critic=critic.mean(), imitation=shown
        )

    def state_dict(self) -> dict[str, Any]:
        """Return the weights of policy and critic, and Adam's moments."""
        return {
            "network": self.network.state_dict(),
            **grounding.state_of(self.grounding),
            "critic": self.critic.state_dict(),
            "critic_hidden": self._critic_hidden,
            "optimiser": self._optimiser.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume exactly from a state of `state_dict`."""
        self.network.load_state_dict(state["network"])
        grounding.load_state_of(self.grounding, state)
        self.critic.load_state_dict(state["critic"])
        hidden = state.get("critic_hidden")
        device = next(self.critic.parameters()).device
        self._critic_hidden = None if hidden is None else hidden.to(device)
        self._optimiser.load_state_dict(state["optimiser"])
