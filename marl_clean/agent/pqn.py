"""Q(lambda) without replay and target network: it learns from the frames just collected."""

from collections.abc import Sequence
from typing import Any, Literal, final

import torch
from jaxtyping import Float
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer
from torchrl.objectives.value.functional import td_lambda_return_estimate

from marl_clean import keys
from marl_clean.comm.base import Comm
from marl_clean.encoder.base import Encoder
from marl_clean.learning import acting
from marl_clean.learning.acting import Greedy, entries
from marl_clean.learning.agent import Agent, Channels, Count
from marl_clean.learning.grounding import ground_loss, grounding_of, load_state_of, state_of
from marl_clean.learning.losses import DISTANCES, margin_loss
from marl_clean.learning.networks import NUM_ACTIONS, QNetwork, noisy_parts, set_noise
from marl_clean.learning.schedules import Discount, Epsilon, linear, set_step_size
from marl_clean.settings import PositiveFloat, Precision, Probability, RisesWith


@final
class Pqn(Agent):
    """Every robot learns the value of its own actions from lambda-returns of the last block.

        G_t = r_t + gamma (1 - terminated) (lambda G_t+1 + (1 - lambda) max_a Q(o_t+1, a))
        loss = Huber(Q(o_t, a_t) - G_t), mean over frames and robots

    The returns are of the network that collected the block, and are estimated once for all epochs.
    After the last step of an episode or a block, G_t+1 is max_a Q(o_t+1, a): truncated episodes are
    bootstrapped. LayerNorm (`encoder.norm=layer`) takes the place of the target network. Robots
    share their weights; messages are recomputed in the loss, so gradients cross live edges. The
    pull of dgn's attention, and masia's prediction, are not learnt.

    Source: PQN, arXiv 2407.04811; TorchRL's returns.

    Args:
        encoder, comm, channels: the network's parts; their weights are learnt in place.
        dueling: see `marl_clean.learning.networks`.
        gamma, gamma_end, gamma_rises_with: discount of a step, see `Discount`; without an end it
            is constant.
        lmbda: of the returns: 0 bootstraps from the next step's values, 1 sums the rewards.
        lr, lr_end: RAdam's step size (arXiv 1908.03265), falling linearly over the run.
        radam_eps: added to the root of RAdam's second moment.
        loss: `smooth_l1` (Huber), `l2` or `l1`.
        max_grad_norm: gradients are scaled down to this norm.
        eps_init, eps_end, annealing_fraction: the share of random actions falls linearly from
            eps_init to eps_end over this fraction of the frames, and stays.
        precision: the encoder's arithmetic; bfloat16 is faster, on devices that have it.
        mask_walls: actions into cells known to be blocked are masked.
        n_agents: robots in a world.
        num_actions: actions of a robot.
        device: where the network lives.
    """

    fits = {"trainer": ["on_policy"]}

    network: QNetwork

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        gamma: Probability,
        lmbda: Probability,
        lr: PositiveFloat,
        lr_end: PositiveFloat,
        radam_eps: PositiveFloat,
        loss: Literal["smooth_l1", "l2", "l1"],
        max_grad_norm: PositiveFloat,
        eps_init: Probability,
        eps_end: Probability,
        annealing_fraction: Probability,
        precision: Precision,
        channels: Channels,
        mask_walls: bool = False,
        gamma_end: Probability | None = None,
        gamma_rises_with: RisesWith = "progress",
        n_agents: Count = 2,
        num_actions: Count = NUM_ACTIONS,
        device: torch.device | str = "cpu",
    ) -> None:
        self.discount = Discount(gamma, gamma_end, gamma_rises_with)
        self.gamma, self.lmbda, self.lr, self.lr_end = gamma, lmbda, lr, lr_end
        self.distance, self.max_grad_norm = DISTANCES[loss], max_grad_norm
        self.n_agents = n_agents
        self.exploring = Epsilon(eps_init, eps_end, annealing_fraction)
        network = QNetwork(encoder, comm, dueling, precision, num_actions, channels, mask_walls)
        self.network = network.to(device).eval()
        self.grounding = grounding_of(self.network.comm, device)
        self._noisy = noisy_parts(self.network)
        learnt = (self.network, *filter(None, [self.grounding]))
        self._parameters = [weight for module in learnt for weight in module.parameters()]
        self._optimiser = torch.optim.RAdam(self._parameters, lr=lr, eps=radam_eps)

    @property
    def history(self) -> int:
        return self.network.history

    def primer(self) -> TensorDictPrimer | None:
        network = self.network
        return acting.primer(network, self.n_agents) if network.carries else None

    @property
    def learns_from(self) -> Sequence[NestedKey]:
        later = (*self.network.sees, keys.REWARD, keys.DONE, keys.TERMINATED)
        return (*self._seen_again, keys.ACTION_VALUE, *(("next", key) for key in later))

    @property
    def _seen_again(self) -> Sequence[NestedKey]:
        """The entries of each frame that every epoch uses."""
        begins = (keys.IS_INIT,) if self.unrolls else ()
        sees = self.network.sees
        grounded_in = () if self.grounding is None else self.grounding.sees
        beside = (key for key in grounded_in if key not in sees)
        return (*sees, keys.ACTION, *begins, *self.shows, *beside)

    def policy(self) -> Greedy:
        return Greedy(self.network, self.n_agents, records_messages=True).eval()

    def exploration(self, action_spec: Composite) -> TensorDictSequential:
        """Return the epsilon-greedy policy; each robot draws for itself."""
        return self._acting(action_spec)

    def demonstrated_by(
        self, planner: TensorDictModuleBase, action_spec: Composite
    ) -> TensorDictSequential:
        return self._acting(action_spec, planner)

    def _acting(
        self, action_spec: Composite, *instead: TensorDictModuleBase
    ) -> TensorDictSequential:
        greedy = Greedy(self.network, self.n_agents, records_messages=False)
        return acting.epsilon_greedy(greedy, self.exploring, action_spec, *instead)

    def measures(self) -> dict[str, float]:
        return {"epsilon": self.exploring.now, **self.moving_gamma(self.discount)}

    def anneal(self, progress: float, finished: float = 0.0) -> None:
        """Set epsilon, step size and discount by a run's progress."""
        self.gamma = self.discount.at(progress, finished)
        set_step_size(self._optimiser, linear(self.lr, self.lr_end, progress))
        self.exploring.anneal(progress)

    @torch.no_grad()
    def estimate(self, block: TensorDictBase) -> TensorDictBase:
        """Return the frames to learn from of a block `[env, time]`, with lambda-returns."""
        frames = block.select(*self._seen_again)
        if self.network.mask_walls:
            acting.allow_taken_(frames)
        later = block["next"]
        done, terminated = (
            later[key].unsqueeze(-2).expand(later[keys.REWARD].shape)
            for key in (keys.DONE, keys.TERMINATED)
        )
        frames[keys.VALUE_TARGET] = td_lambda_return_estimate(
            self.gamma,
            self.lmbda,
            self.next_values(block),
            later[keys.REWARD],
            done,
            terminated,
            time_dim=1,
        )
        return frames

    def next_values(self, block: TensorDictBase) -> Float[Tensor, "env time agent 1"]:
        """Return max_a Q(o_t+1, a) of a block.

        Frame t + 1 was valued when the robots acted in it; only frames at which an episode or the
        block ends are valued here.
        """
        value = block[keys.ACTION_VALUE].amax(-1, keepdim=True).roll(-1, dims=1)
        last = acting.last_frames(block)
        seen = entries(self.network, block["next"][last])
        value[last] = self.network(seen).out.amax(-1, keepdim=True)
        return value

    def loss(self, frames: TensorDictBase) -> Float[Tensor, ""]:
        """Return the distance of the values of the chosen actions from their returns.

            loss = Huber(Q(o_t, a_t) - G_t), mean over frames and robots

        Where a planner acted, `margin_loss` is added.
        """
        seen = entries(self.network, frames)
        if self.unrolls:
            values = self.network.unroll(frames[keys.IS_INIT], seen)
        else:
            values = self.network(seen).out
        value = values.gather(-1, frames[keys.ACTION].unsqueeze(-1))
        loss = self.distance(value, frames[keys.VALUE_TARGET])
        return loss + margin_loss(values, frames[keys.DEMONSTRATION]) if self.demonstrated else loss

    def update(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Make one step of RAdam on a minibatch: frames, or rows `[env, time]` if it unrolls."""
        set_noise(self._noisy, True)
        grounded, measures = ground_loss(self.grounding, self.network, batch)
        loss = self.loss(batch) + grounded
        self._optimiser.zero_grad()
        loss.backward()
        grad_norm = nn.utils.clip_grad_norm_(self._parameters, self.max_grad_norm)
        self._optimiser.step()
        set_noise(self._noisy, False)
        return {"loss": loss.detach(), "grad_norm": grad_norm, **measures}

    def state_dict(self) -> dict[str, Any]:
        """Return the weights and RAdam's moments."""
        return {
            "network": self.network.state_dict(),
            **state_of(self.grounding),
            "optimiser": self._optimiser.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Resume exactly from a state of `state_dict`."""
        self.network.load_state_dict(state["network"])
        load_state_of(self.grounding, state)
        self._optimiser.load_state_dict(state["optimiser"])
