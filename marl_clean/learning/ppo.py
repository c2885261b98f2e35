"""Proximal policy optimisation, as several learners share it."""

import copy
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Float
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.learning import acting
from marl_clean.learning.acting import Greedy, entries, record_carried
from marl_clean.learning.agent import Agent, Channels, Count
from marl_clean.learning.networks import NUM_ACTIONS, RobotsNetwork, noisy_parts, set_noise
from marl_clean.learning.schedules import linear, set_step_size
from marl_clean.settings import (
    NonNegativeFloat,
    PositiveFloat,
    PositiveShare,
    Precision,
    Probability,
)

DONE, TERMINATED = (keys.AGENTS, keys.DONE), (keys.AGENTS, keys.TERMINATED)


class Logits(TensorDictModuleBase):
    """Every robot's logits, and while it acts what the network carries."""

    def __init__(self, network: RobotsNetwork, acting: bool) -> None:
        super().__init__()
        self.network, self.acting = network, acting
        self.in_keys = list(network.sees)
        carried = [("next", key) for key in network.carries] if acting else []
        self.out_keys = [keys.LOGITS, *carried]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        seen = entries(self.network, tensordict)
        if not self.acting and self.network.unrolls:
            logits = self.network.unroll(tensordict.get(keys.IS_INIT), seen)
        else:
            logits, _, carried = self.network(seen)
            if self.acting:
                record_carried(tensordict, carried)
        return tensordict.set(keys.LOGITS, logits)


class Critic(nn.Module):
    """The value of every robot's state, from what robots see.

        local:   V_i = head(relu(W h_i)),                                   h_i = encoder(o_i)
        central: V_i = head(relu(W [h_i, mean over all robots j of h_j]))

    It has an encoder of its own, does not talk and remembers nothing; any number of robots fits.
    """

    def __init__(self, encoder: Encoder, central: bool, precision: Precision) -> None:
        super().__init__()
        self.encoder, self.central = encoder, central
        self.reduced = precision == "bfloat16"
        width = encoder.out_features
        self.head = nn.Sequential(
            nn.Linear((1 + central) * width, width), nn.ReLU(), nn.Linear(width, 1)
        )

    def forward(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch agent 1"]:
        with torch.autocast(observation.device.type, torch.bfloat16, enabled=self.reduced):
            feature = self.encoder(observation)
        feature = feature.float()
        if self.central:
            mean = feature.mean(-2, keepdim=True).expand_as(feature)
            feature = torch.cat([feature, mean], dim=-1)
        return self.head(feature)


class Ppo(Agent):
    """Learn a policy that draws its actions, by clipped steps (arXiv 1707.06347).

        A_i by generalised advantage estimation over r_i and the critic's V (arXiv 1506.02438)
        ratio_i = pi(a_i | o) / pi_old(a_i | o)
        loss = -mean min(ratio A, clip(ratio, 1 - clip_epsilon, 1 + clip_epsilon) A)
               + critic_coeff (V - return)^2 or Huber - entropy_coeff entropy

    Truncated episodes are bootstrapped, terminated ones are not. All robots share the weights;
    messages are made anew in the loss, so gradients cross live edges. Measured and watched is the
    most likely action. The critic is for learning alone.

    What draws while it learns (dropout, dial's noise, ic3net's gate) does not while it collects, so
    ratios differ from 1 even in the first step on a block.

    Args:
        encoder, comm, channels: the policy's parts; the critic gets an encoder of the same kind.
        gamma: discount of a step.
        lmbda: of the advantages: 0 trusts the critic, 1 the returns.
        clip_epsilon: how far a ratio may move.
        entropy_coeff: weight of the entropy bonus.
        critic_coeff: weight of the critic's loss.
        critic_loss: `smooth_l1` (Huber), `l2` or `l1`.
        normalize_advantage: to mean 0 and deviation 1 in each minibatch.
        lr, lr_end: Adam's step size, falling linearly over the run.
        max_grad_norm: gradients are scaled down to this norm.
        precision: the encoders' arithmetic; bfloat16 is faster.
        mask_walls: no action into a cell known to be blocked is considered.
        n_agents: robots in a world.
        num_actions: actions of a robot.
        device: where the networks live.
    """

    fits = {"trainer": ["on_policy"]}
    central: ClassVar[bool]  # whether the critic knows what all robots see
    loss_class: ClassVar[type[ClipPPOLoss]]

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
        n_agents: Count = 2,
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.gamma, self.lr, self.lr_end = gamma, lr, lr_end
        self.max_grad_norm = max_grad_norm
        self.n_agents = n_agents
        critic = Critic(_fresh(encoder), self.central, precision)
        network = RobotsNetwork(encoder, comm, num_actions, precision, channels, mask_walls)
        self.network, self.critic = network.to(device).eval(), critic.to(device).eval()
        values = TensorDictModule(self.critic, [keys.OBSERVATION], [keys.STATE_VALUE])
        self._loss = self.loss_class(
            self._drawing(acting=False),
            values,
            clip_epsilon=clip_epsilon,
            entropy_coeff=entropy_coeff,
            critic_coeff=critic_coeff,
            loss_critic_type=critic_loss,
            normalize_advantage=normalize_advantage,
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
        self._parameters = [*self.network.parameters(), *self.critic.parameters()]
        self._optimiser = torch.optim.Adam(self._parameters, lr=lr, fused=True)

    def _drawing(self, acting: bool) -> ProbabilisticTensorDictSequential:
        """Return TorchRL's actor: the network's logits, and an action drawn for each robot."""
        draw = ProbabilisticTensorDictModule(
            in_keys={"logits": keys.LOGITS},
            out_keys=[keys.ACTION],
            distribution_class=Categorical,
            return_log_prob=True,
            log_prob_key=keys.LOG_PROB,
        )
        return ProbabilisticTensorDictSequential(Logits(self.network, acting).eval(), draw)

    @property
    def history(self) -> int:
        return self.network.history

    def primer(self) -> TensorDictPrimer | None:
        network = self.network
        return acting.primer(network, self.n_agents) if network.carries else None

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        later = (keys.OBSERVATION, keys.REWARD, keys.DONE, keys.TERMINATED)
        begins = (keys.IS_INIT,) if self.unrolls else ()
        now = (*self.network.sees, keys.ACTION, keys.LOG_PROB, *begins)
        return (*now, *(("next", key) for key in later))

    def policy(self) -> Greedy:
        return Greedy(self.network, self.n_agents, records_messages=True).eval()

    def exploration(self, action_spec: Composite) -> TensorDictModuleBase:
        """Return the policy that draws; it draws under TorchRL's `ExplorationType.RANDOM`."""
        return self._drawing(acting=True)

    def anneal(self, progress: float) -> None:
        """Set the step size for a run of which `progress`, 0 to 1, is done."""
        set_step_size(self._optimiser, linear(self.lr, self.lr_end, progress))

    def estimate(self, block: TensorDictBase) -> TensorDictBase:
        """Return what is learnt from a block `[env, time]`: advantages and returns added."""
        frames = block.select(*self.learns_from)
        acting.give_robots_endings(frames)
        if self.network.mask_walls:
            acting.allow_taken_(frames)
        with torch.no_grad():  # GAE itself would call the critic under vmap, which convolutions
            for part in (frames, frames["next"]):  # with channels last do not go through
                part[keys.STATE_VALUE] = self.critic(part[keys.OBSERVATION])
            self._advantages(frames)
        return frames.exclude("next", keys.STATE_VALUE)

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Take one step of Adam on a minibatch: frames, or rows `[env, time]` if it unrolls."""
        set_noise(self._noisy, True)
        losses = self._loss(batch)
        loss = losses["loss_objective"] + losses["loss_entropy"] + losses["loss_critic"]
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        set_noise(self._noisy, False)
        names = ("entropy", "kl_approx", "clip_fraction")
        measures = {name: losses[name].detach() for name in names}
        critic = losses["loss_critic"].detach()
        return {"loss": loss.detach(), "loss_critic": critic, "grad_norm": grad_norm, **measures}

    def state_dict(self) -> dict[str, Any]:
        """Return the weights of policy and critic, and Adam's moments."""
        return {
            "network": self.network.state_dict(),
            "critic": self.critic.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume exactly from a state of `state_dict`."""
        self.network.load_state_dict(state["network"])
        self.critic.load_state_dict(state["critic"])
        self._optimiser.load_state_dict(state["optimiser"])


def _fresh(encoder: Encoder) -> Encoder:
    """Return an encoder of the same kind with weights of its own, drawn anew, and no memory."""
    other = copy.deepcopy(encoder)
    other.memory = None
    for module in other.modules():
        if isinstance(module, nn.Linear | nn.Conv2d):
            module.reset_parameters()
    return other
