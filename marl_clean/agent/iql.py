"""Independent deep Q-learning with shared weights: the learner of the paper (§2, §3.4)."""

from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.modules import EGreedyModule
from torchrl.objectives import DQNLoss, HardUpdate, SoftUpdate
from torchrl.objectives.utils import TargetNetUpdater

from marl_clean import keys, symmetry
from marl_clean.agent.base import NUM_ACTIONS, Agent, Count, QNetwork
from marl_clean.comm.base import Comm
from marl_clean.settings import PositiveFloat, PositiveInt, PositiveShare, Precision, Probability

SEEN = (keys.OBSERVATION, keys.ADJACENCY, keys.DISTANCE_RANK)
DONE, TERMINATED = (keys.AGENTS, keys.DONE), (keys.AGENTS, keys.TERMINATED)


class Greedy(TensorDictModuleBase):
    """Every robot's best action: the network, as what TorchRL calls a Q-value actor.

    One module in the place of three (network, choice, their sequence): a third of their time
    outside of the network, which counts where the network is small.
    """

    def __init__(self, network: QNetwork, tells: bool) -> None:
        super().__init__()
        self.network, self.tells = network, tells
        self.in_keys = list(SEEN)
        self.out_keys = [keys.ACTION, keys.ACTION_VALUE, keys.CHOSEN_ACTION_VALUE]
        if tells:
            self.out_keys += [keys.MESSAGE, keys.MESSAGE_BITS]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        value, message, bits = self.network(*(tensordict.get(key) for key in SEEN))
        chosen, action = value.max(-1, keepdim=True)
        tensordict.set(keys.ACTION_VALUE, value)
        tensordict.set(keys.CHOSEN_ACTION_VALUE, chosen)
        tensordict.set(keys.ACTION, action.squeeze(-1))
        if self.tells:
            tensordict.set(keys.MESSAGE, message)
            tensordict.set(keys.MESSAGE_BITS, bits)
        return tensordict


class SoftUpdateAtOnce(SoftUpdate):
    """TorchRL's soft update, with one call for all weights: a tenth of its time."""

    def init_(self) -> None:
        super().init_()
        self._weights = [weight.data for weight in self._sources.values(True, True)]
        self._followers = [weight.data for weight in self._targets.values(True, True)]

    def step(self) -> None:
        torch._foreach_lerp_(self._followers, self._weights, 1 - self.eps)


class Iql(Agent):
    """Every robot learns the value of its own actions by deep Q-learning (arXiv 1312.5602).

        y_i = r_i + gamma^k (1 - terminated) Q'(o'_i, argmax_a Q(o'_i, a))
        loss = Huber(Q(o_i, a_i) - y_i), mean over frames and robots

    with Q' the target network, k the steps to the next observation (`n_steps`, fewer at an
    episode's end), and the argmax taken by Q if `double` (arXiv 1509.06461), else by Q'.
    Dropout, where the encoder has it, is active in all of Q and Q' while learning.
    Messages are made anew from the replayed observations and adjacency, so the gradient of one
    robot's loss reaches the others along live edges. Truncated episodes are bootstrapped.

    Args:
        encoder, comm: the network's parts; their weights are learnt in place.
        double, dueling: see above and `QNetwork`.
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
        num_actions: actions of a robot.
        device: where the network lives.
    """

    network: QNetwork
    learns_from = (
        *SEEN,
        keys.ACTION,
        *(("next", key) for key in (*SEEN, keys.REWARD, keys.DONE, keys.TERMINATED)),
    )

    def __init__(
        self,
        encoder: nn.Module,
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
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.gamma, self.n_steps = gamma, n_steps
        self.eps_init, self.eps_end, self.annealing_fraction = eps_init, eps_end, annealing_fraction
        self.lr, self.lr_end = lr, lr_end
        self.max_grad_norm = max_grad_norm
        self.augment = augment
        network = QNetwork(encoder, comm, dueling, precision, num_actions)
        self.network = network.to(device).eval()
        self._greedy = Greedy(self.network, tells=False).eval()
        self._loss = DQNLoss(
            self._greedy, loss_function=loss, double_dqn=double, action_space="categorical"
        )
        self._loss.set_keys(
            action=keys.ACTION,
            action_value=keys.ACTION_VALUE,
            value=keys.CHOSEN_ACTION_VALUE,
            reward=keys.REWARD,
            done=DONE,
            terminated=TERMINATED,
        )
        self._loss.make_value_estimator(gamma=gamma)
        self._target: TargetNetUpdater
        if target_update == "soft":
            self._target = SoftUpdateAtOnce(self._loss, tau=tau)
        else:  # HardUpdate copies in the update after its interval is full
            self._target = HardUpdate(self._loss, value_network_update_interval=target_period - 1)
        self._dropouts = [m for m in self.network.modules() if isinstance(m, nn.Dropout)]
        self._parameters = list(self.network.parameters())
        self._optimiser = torch.optim.Adam(self._parameters, lr=lr, fused=True)
        self._coin: EGreedyModule | None = None
        self.anneal(0.0)

    def policy(self) -> Greedy:
        """Return the greedy policy; it follows the weights as they are learnt."""
        return Greedy(self.network, tells=True).eval()

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy; each robot draws for itself.

        It explores only under TorchRL's `ExplorationType.RANDOM`, as a Collector sets it.
        """
        device = next(self.network.parameters()).device
        self._coin = EGreedyModule(action_spec, action_key=keys.ACTION, device=device)
        self._coin.eps.fill_(self.epsilon)
        return TensorDictSequential(self._greedy, self._coin)

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
        self._set_dropout(True)
        loss = self._loss(self._frames_to_learn(batch))["loss"]
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        self._target.step()
        self._set_dropout(False)
        return {"loss": loss.detach(), "grad_norm": grad_norm}

    def _set_dropout(self, active: bool) -> None:
        for module in self._dropouts:
            module.train(active)

    def _frames_to_learn(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the batch with what the loss wants a robot: endings and steps; and augmented."""
        frames = batch.select(*self.learns_from)
        reward = frames["next", keys.REWARD]
        for key in (keys.DONE, keys.TERMINATED):
            ending = frames["next", key].unsqueeze(-1).expand(reward.shape)
            frames["next", keys.AGENTS, key] = ending
        steps = batch[keys.STEPS_TO_NEXT_OBS]
        frames[keys.STEPS_TO_NEXT_OBS] = steps[:, None, None].expand(reward.shape)
        if self.augment:
            now, then = frames[keys.OBSERVATION], frames["next", keys.OBSERVATION]
            (now, then), action = symmetry.turn_in_eighths([now, then], frames[keys.ACTION])
            frames[keys.OBSERVATION], frames["next", keys.OBSERVATION] = now, then
            frames[keys.ACTION] = action
        return frames

    def state_dict(self) -> dict[str, Any]:
        """Return weights, target weights, Adam's moments and the target's counter."""
        return {
            "network": self.network.state_dict(),
            "target": self._target_weights(),
            "optimiser": self._optimiser.state_dict(),
            "target_update": self._target.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state of `state_dict`, exactly."""
        self.network.load_state_dict(state["network"])
        for name, weight in self._target_weights().items():
            weight.copy_(state["target"][name])
        self._optimiser.load_state_dict(state["optimiser"])
        self._target.load_state_dict(state["target_update"])

    def _target_weights(self) -> dict[str, Tensor]:
        """Return the target network's weights by the names that the network gives its own."""
        parameters = self._loss.target_value_network_params["network"].flatten_keys(".")
        return {name: weight.data for name, weight in parameters.items()}
