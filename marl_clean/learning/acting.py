"""What several learners share: reading and writing what networks and losses take of a frame."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torch import Tensor, nn
from torch.distributions import Categorical
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer

from marl_clean import keys
from marl_clean.comm._decoding import Decoding
from marl_clean.comm.base import Talk
from marl_clean.errors import BadInput
from marl_clean.learning.networks import Entries, RobotsNetwork
from marl_clean.learning.schedules import Epsilon
from marl_clean.world.random import Purpose, random_bits

_Shape = torch.Size | list[int] | tuple[int, ...]
_NO_SHAPE = torch.Size()
OF_MESSAGES = (keys.MESSAGE, keys.MESSAGE_EDGES, keys.MESSAGE_BITS)
OF_TOLD = (keys.TOLD_PATCH, keys.TOLD_EDGES, keys.TOLD_PLACE)
"""What policies write for an env whose robots read in messages what lies around the senders."""


def entries(network: RobotsNetwork, frame: TensorDictBase) -> Entries:
    """Return what the network sees of a frame, by key.

    Raises:
        BadInput: the frame lacks some of it; what is carried from step to step must come from an
            env that starts episodes with it, since its loss in a loop would go unnoticed.
    """
    seen = {key: frame.get(key) for key in network.sees}
    if any(entry is None for entry in seen.values()):
        lacking = [key for key, entry in seen.items() if entry is None]
        raise BadInput(_what_to_append(network, lacking))
    return seen


def _what_to_append(network: RobotsNetwork, lacking: Sequence[NestedKey]) -> str:
    names = ", ".join(str(key[-1]) for key in lacking)
    own = "or use marl_clean.make_env(checkpoint=RUN), which has all that a run's policy needs"
    if set(lacking) <= {*network.carries}:
        return (
            f"policy: carries {names} from step to step, and this env does not hold it;"
            f" env.append_transform(policy.make_tensordict_primer()), {own}"
        )
    if keys.CHANNEL_SEED in lacking:
        return (
            f"policy: it or its channel draws, and this env has no {names};"
            f" env.append_transform(marl_clean.env.channel_seed.ChannelSeed()), {own}"
        )
    return f"policy: sees {names}, and this env shows none; {own[3:]}"


def begin_carrying(policy: nn.Module, frame: TensorDictBase) -> TensorDictBase:
    """Write into a first frame that nothing is carried yet, as an env with the primer does."""
    if isinstance(policy, Greedy):
        specs = policy.network.state_specs(frame.get(keys.ADJACENCY).shape[-1])
        for key, spec in specs.items():
            frame.set(key, spec.zero(frame.batch_size).to(frame.device))
    return frame


def primer(network: RobotsNetwork, n_agents: int) -> TensorDictPrimer:
    """Return TorchRL's transform that lets the episodes of an env begin with nothing carried."""
    specs = Composite({keys.AGENTS: Composite(shape=(n_agents,))})
    specs.update(network.state_specs(n_agents))
    return TensorDictPrimer(specs, default_value=0.0, expand_specs=True)


def record_carried(frame: TensorDictBase, carried: Entries) -> None:
    """Write in place what is carried to where the next frame will have it."""
    for key, value in carried.items():
        frame.set(("next", key), value)


def record_messages(frame: TensorDictBase, talk: Talk) -> None:
    """Write in place what was sent, and what it cost."""
    for key, value in zip(OF_MESSAGES, (talk.message, talk.edges, talk.bits), strict=True):
        frame.set(key, value)


def record_told(frame: TensorDictBase, network: RobotsNetwork, talk: Talk) -> None:
    """Write in place, for the env, what was read in messages, of schemes that decode them."""
    comm = network.comm
    if talk.told is not None and isinstance(comm, Decoding):
        frame.set(keys.TOLD_PATCH, comm.patch_of(talk.told.heard))
        frame.set(keys.TOLD_EDGES, talk.told.live)
        frame.set(keys.TOLD_PLACE, frame.get(keys.POSITION))


def give_robots_endings(frames: TensorDictBase) -> None:
    """Write for each robot that it ended when its world did, `[*B, agent, 1]`."""
    shape = frames["next", keys.REWARD].shape
    for key in (keys.DONE, keys.TERMINATED):
        frames["next", keys.AGENTS, key] = frames["next", key].unsqueeze(-1).expand(shape)


def last_frames(block: TensorDictBase) -> Bool[Tensor, "env time"]:
    """Return which frames of a block no frame follows: an episode's last, and the block's."""
    last = block["next", keys.DONE].squeeze(-1).clone()
    last[:, -1] = True
    return last


def drawn(
    logits: Float[Tensor, "*batch agent action"], seed: Int[Tensor, "*batch agent"]
) -> Int[Tensor, "*batch agent"]:
    """Draw each robot's action by softmax, as a pure function of its seed.

    The greatest of logit + Gumbel noise is distributed so.
    """
    action = torch.arange(logits.shape[-1], device=logits.device)
    bits = random_bits(int(Purpose.ACTION), seed.unsqueeze(-1), Purpose.ACTION, action)
    uniform = (bits.double() + 0.5) / 2**32
    return (logits.double() - (-uniform.log()).log()).argmax(-1)


def allow_taken_(frames: TensorDictBase) -> None:
    """Let masks allow what was done, in place: its value and its probability are learnt.

    Others than the policy may have acted, such as a planner.
    """
    taken = frames[keys.ACTION].unsqueeze(-1)
    frames[keys.ACTION_MASK] = frames[keys.ACTION_MASK].scatter(-1, taken, True)


def team_reward(frames: TensorDictBase) -> Float[Tensor, "*batch 1"]:
    """Return what the team is paid: under `reward=team` it is the same for each robot."""
    return frames["next", keys.REWARD][..., 0, :]


class Logits(TensorDictModuleBase):
    """Every robot's logits, and while it acts what the network carries."""

    def __init__(self, network: RobotsNetwork, acting: bool) -> None:
        super().__init__()
        self.network, self.acting = network, acting
        self.in_keys = list(network.sees)
        carried = [("next", key) for key in network.carries] if acting else []
        told = OF_TOLD if acting and network.comm.decodes else ()
        self.out_keys = [keys.LOGITS, *told, *carried]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        seen = entries(self.network, tensordict)
        if not self.acting and self.network.unrolls:
            logits = self.network.unroll(tensordict.get(keys.IS_INIT), seen)
        else:
            logits, talk, carried = self.network(seen)
            if self.acting:
                record_carried(tensordict, carried)
                record_told(tensordict, self.network, talk)
        return tensordict.set(keys.LOGITS, logits)


class Choice(Categorical):
    """Torch's distribution, which goes on where logits are NaN or infinite: it draws any action.

    So no draw fails, on a GPU for good, before the trainer has read that the logits, and with them
    what is learnt from `log_prob`, are not finite. Of finite logits all is torch's, bit for bit.
    """

    @property
    def deterministic_sample(self) -> Tensor:
        return self.mode

    def sample(self, sample_shape: _Shape = _NO_SHAPE) -> Tensor:
        self.probs = torch.where(self.probs.isfinite(), self.probs, 1.0)
        return super().sample(sample_shape)

    def entropy(self) -> Tensor:
        """Return the entropy, 0 where it is NaN: TorchRL would draw actions to estimate it."""
        return super().entropy().nan_to_num()


def drawing(network: RobotsNetwork, acting: bool) -> ProbabilisticTensorDictSequential:
    """Return TorchRL's actor: the network's logits, and an action drawn for each robot."""
    draw = ProbabilisticTensorDictModule(
        in_keys={"logits": keys.LOGITS},
        out_keys=[keys.ACTION],
        distribution_class=Choice,
        return_log_prob=True,
        log_prob_key=keys.LOG_PROB,
    )
    return ProbabilisticTensorDictSequential(Logits(network, acting).eval(), draw)


class Greedy(TensorDictModuleBase):
    """Every robot's best action, by values or by logits: what TorchRL calls a Q-value actor.

    With `draws` the action is drawn by the logits instead, and by nothing but what frames hold.

    One module in the place of three (network, choice, their sequence): a third of their time
    outside of the network, which counts where the network is small. What the network carries is
    written into the next frame.

    Args:
        network: values, or logits, of the robots' actions.
        n_agents: robots in a world.
        records_messages: what was sent is written into the frame, too.
        draws: see above.
    """

    def __init__(
        self, network: RobotsNetwork, n_agents: int, records_messages: bool, draws: bool = False
    ) -> None:
        super().__init__()
        self.network, self.n_agents, self.records_messages = network, n_agents, records_messages
        self.draws = draws
        drawn_by = [keys.CHANNEL_SEED] if draws and keys.CHANNEL_SEED not in network.sees else []
        self.in_keys = [*network.sees, *drawn_by]
        self.out_keys = [keys.ACTION, keys.ACTION_VALUE, keys.CHOSEN_ACTION_VALUE]
        if records_messages:
            self.out_keys += OF_MESSAGES
        self.out_keys += OF_TOLD if network.comm.decodes else ()
        self.out_keys += [("next", key) for key in network.carries]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        value, talk, carried = self.network(entries(self.network, tensordict))
        record_carried(tensordict, carried)
        record_told(tensordict, self.network, talk)
        if self.records_messages:
            record_messages(tensordict, talk)
        if self.draws:
            action = drawn(value, self.seed_in(tensordict)).unsqueeze(-1)
            chosen = value.gather(-1, action)
        else:
            chosen, action = value.max(-1, keepdim=True)
        tensordict.set(keys.ACTION_VALUE, value)
        tensordict.set(keys.CHOSEN_ACTION_VALUE, chosen)
        tensordict.set(keys.ACTION, action.squeeze(-1))
        return tensordict

    def seed_in(self, frame: TensorDictBase) -> Int[Tensor, "*batch agent"]:
        """Return what is drawn by. Raises BadInput where the frame lacks it."""
        seed = frame.get(keys.CHANNEL_SEED)
        if seed is None:
            raise BadInput(_what_to_append(self.network, [keys.CHANNEL_SEED]))
        return seed

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """Return the transform by which an env begins episodes with what the network carries."""
        return primer(self.network, self.n_agents)


def epsilon_greedy(
    greedy: Greedy, exploring: Epsilon, action_spec: Composite, *instead: TensorDictModuleBase
) -> TensorDictSequential:
    """Return the policy in which each robot draws a random action with probability epsilon.

    Its other actions are the greedy ones, or those that the modules `instead` write over them.
    """
    mask = keys.ACTION_MASK if greedy.network.mask_walls else None
    coin = exploring.coin(action_spec, keys.ACTION, mask)
    return TensorDictSequential(greedy.eval(), *instead, coin)
