"""The networks from what robots see to action values, that several learners share."""

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from tensordict.utils import NestedKey, expand_as_right
from torch import Tensor, nn
from torchrl.data import TensorSpec, Unbounded

from marl_clean import keys
from marl_clean.channel.base import Channel
from marl_clean.channel.delayed import Later
from marl_clean.channel.perfect import Perfect
from marl_clean.comm.base import Comm, Delivery, NoisyWhileLearning, Senders, Talk
from marl_clean.encoder.base import Encoder
from marl_clean.learning.arithmetic import reduced_for
from marl_clean.learning.delivery import Repeated, Stacked, state_keys
from marl_clean.settings import Precision

Entries = Mapping[NestedKey, Tensor]
"""Entries of frames, by the keys that they have there."""

NUM_ACTIONS = 4
"""Up, right, down, left (paper §3.2); there is no action to stay."""


def duel(value: Float[Tensor, "*batch one_and_actions"]) -> Float[Tensor, "*batch action"]:
    """Join a state's value and its actions' advantages: V + A_a - mean over a' of A_a'.

    Source: dueling networks, arXiv 1511.06581.
    """
    advantage = value[..., 1:]
    return value[..., :1] + advantage - advantage.mean(-1, keepdim=True)


def masked(
    out: Float[Tensor, "*batch action"], allowed: Bool[Tensor, "*batch action"]
) -> Float[Tensor, "*batch action"]:
    """Return values or logits, the least finite number where an action is not allowed."""
    return out.masked_fill(~allowed, torch.finfo(out.dtype).min)


def noisy_parts(network: nn.Module) -> list[nn.Module]:
    """Return the parts that draw while the network learns, and only then."""
    return [m for m in network.modules() if isinstance(m, nn.Dropout | NoisyWhileLearning)]


def set_noise(parts: Iterable[nn.Module], active: bool) -> None:
    """Let noisy parts draw, or be functions of their input."""
    for part in parts:
        part.train(active)


def _begun_anew(carried: Entries, begins: Bool[Tensor, "*batch"]) -> Entries:
    """Return what is carried, zeros where an episode begins."""
    return {
        key: torch.where(expand_as_right(begins, value), torch.zeros_like(value), value)
        for key, value in carried.items()
    }


class Decision(NamedTuple):
    """What robots make of one step.

    Attributes:
        out: `[*B, n, outputs]`, action values or logits.
        talk: what was sent, and what it cost.
        carried: what the next step takes up, by the keys of `carries`.
    """

    out: Tensor
    talk: Talk
    carried: Entries


class RobotsNetwork(nn.Module):
    """What every robot makes of what it sees and hears: encoder, talk, head (paper figure 4).

        h_i = encoder(o_i), with memory GRU(encoder(o_i), h_i of the step before)
        out_i = head(comm(h, adjacency, over the channels)_i)

    All robots share the weights, so any number of robots fits. `precision` is that of the
    encoder's arithmetic, where the time goes; messages and outputs stay float32. With `mask_walls`
    outputs of actions that the frame's `action_mask` forbids are the least finite number, so that
    no maximum and no distribution considers them.

    Attributes:
        sees: the keys of the entries that `forward` takes.
        carries: the keys among them that it makes itself for the next step: a robot's memory,
            messages under way, the channel's state. An episode begins with zeros.
        history: how many steps gradients go back at least; then it learns from frames in a row.
    """

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        outputs: int,
        precision: Precision,
        channels: Mapping[str, Channel],
        mask_walls: bool = False,
    ) -> None:
        super().__init__()
        self.encoder = encoder
        self.comm = comm
        self.mask_walls = mask_walls
        self.precision: Precision = precision
        self.head = nn.Linear(comm.out_features, outputs)
        crossed = {name: each for name, each in channels.items() if not isinstance(each, Perfect)}
        if comm.delay_steps:
            crossed = {"later": Later(comm.delay_steps, tuple(comm.message_dims)), **crossed}
        self.channel = nn.ModuleDict(crossed if comm.rounds else {})  # as weights name it
        self.stack: list[Channel] = list(self.channel.values())  # type: ignore[arg-type]
        self._look_through()

    @property
    def unrolls(self) -> bool:
        """Whether it learns from frames in a row."""
        return self.history > 0

    def put_behind(self, channel: Channel) -> None:
        """Let messages cross one more channel, nearest to the receiver; nothing of it is kept."""
        self.stack.append(channel)
        self._look_through()

    def _look_through(self) -> None:
        """Find out what the channels need of a frame."""
        self.draws = any(channel.draws for channel in self.stack)
        memory = () if self.encoder.memory is None else (keys.HIDDEN,)
        if self.comm.remembers:
            memory = (*memory, keys.COMM_HIDDEN)
        behind = (type(channel).__name__ for channel in self.stack[len(self.channel) :])
        self.carries = (*memory, *state_keys(self.stack, [*self.channel, *behind]))
        drawn = (keys.CHANNEL_SEED,) if self.draws else ()
        mask = (keys.ACTION_MASK,) if self.mask_walls else ()
        graph = keys.GRAPH if self.comm.places else keys.GRAPH[:2]
        read = () if self.comm.reads is None else ((keys.AGENTS, self.comm.reads),)
        self.sees = (keys.OBSERVATION, *graph, *read, *mask, *drawn, *self.carries)
        late = sum(channel.steps_late for channel in self.stack)
        self.history = max(int(bool(memory)), late)

    def state_specs(self, n_agents: int) -> dict[NestedKey, TensorSpec]:
        """Return the spec of each key of `carries`, without batch."""
        specs = {}
        if self.encoder.memory is not None:
            specs[keys.HIDDEN] = Unbounded(shape=(n_agents, self.encoder.memory.hidden_size))
        if self.comm.remembers:
            specs[keys.COMM_HIDDEN] = Unbounded(shape=(n_agents, self.comm.remembers))
        dims = tuple(self.comm.message_dims)
        for channel in self.stack:
            if channel.remembers is not None:
                specs[channel.remembers] = channel.state_spec(n_agents, dims)
        return specs

    def forward(
        self, seen: Entries, sent: Float[Tensor, "*batch agent message"] | None = None
    ) -> Decision:
        """Decide on a frame's entries, those of `sees` by their keys.

        The observation is [*batch, agent, ...], as the encoder takes it. With `sent`, these
        messages are delivered, whatever the robots would send.
        """
        return self.decide(self.encode(seen[keys.OBSERVATION]), seen, sent)

    def encode(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch agent feature"]:
        """Return what the encoder makes of observations, in its own precision."""
        with reduced_for(observation, self.precision):
            feature = self.encoder(observation)
        return feature.float()

    def decide(
        self,
        feature: Float[Tensor, "*batch agent feature"],
        seen: Entries,
        sent: Float[Tensor, "*batch agent message"] | None = None,
    ) -> Decision:
        """Return what `forward` does, from features of the encoder and the other entries."""
        carried: dict[NestedKey, Tensor] = {}
        if self.encoder.memory is not None:
            hidden = seen[keys.HIDDEN].flatten(0, -2)
            remembered = self.encoder.memory(feature.flatten(0, -2), hidden)
            feature = carried[keys.HIDDEN] = remembered.unflatten(0, feature.shape[:-1])
        adjacency, distance_rank = seen[keys.ADJACENCY], seen[keys.DISTANCE_RANK]
        stacked = Stacked(
            self.stack,
            adjacency,
            distance_rank,
            self.comm.rounds,
            seen[keys.CHANNEL_SEED] if self.draws else None,
            [None if each.remembers is None else seen[each.remembers] for each in self.stack],
            self.comm.gated,
        )
        delivery: Delivery = stacked
        if sent is not None:
            delivery = Repeated(stacked, sent, self.comm.message_dims[: self.comm.rounds])
        senders = Senders(distance_rank, seen[keys.OFFSET] if self.comm.places else None)
        before = seen[keys.COMM_HIDDEN] if self.comm.remembers else None

        def out(feature: Float[Tensor, "*batch joined"]) -> Float[Tensor, "*batch out"]:
            """Return outputs of features, of each robot or of several variants of each."""
            outputs = self.out(feature)
            if not self.mask_walls:
                return outputs
            allowed = seen[keys.ACTION_MASK]
            return masked(
                outputs, allowed.unsqueeze(-2) if outputs.ndim > allowed.ndim else allowed
            )

        read = None if self.comm.reads is None else seen[keys.AGENTS, self.comm.reads]
        talk = self.comm(feature, adjacency, senders, delivery, before, out, read)
        if talk.hidden is not None:
            carried[keys.COMM_HIDDEN] = talk.hidden
        return Decision(out(talk.feature), talk, carried | stacked.states_after())

    def unroll(
        self,
        begins: Bool[Tensor, "*batch time 1"],
        seen: Entries,
        sent: Float[Tensor, "*batch time agent message"] | None = None,
    ) -> Float[Tensor, "*batch time agent out"]:
        """Return the outputs over frames in a row; gradients cross from frame to frame.

        What is carried comes from the first frame as it was collected, and from then on is made
        anew with the present weights; where an episode `begins` it is zeros.
        """
        decisions = list(self._in_a_row(begins, seen, sent))
        return torch.stack([decision.out for decision in decisions], dim=begins.ndim - 2)

    def talks(self, seen: Entries, begins: Bool[Tensor, "*batch time 1"] | None = None) -> Talk:
        """Return what is said in frames; in frames in a row, with `begins`, as `unroll` does.

        Of the latter features, attention and what is carried are left out.
        """
        if begins is None:
            return self(seen).talk
        talks = [decision.talk for decision in self._in_a_row(begins, seen)]
        sent = zip(*((t.message, t.edges, t.bits) for t in talks), strict=True)
        message, edges, bits = (torch.stack(each, dim=begins.ndim - 2) for each in sent)
        made = [talk.represented for talk in talks if talk.represented is not None]
        represented = torch.stack(made, dim=begins.ndim - 2) if made else None
        return Talk(message[..., :0], message, edges, bits, represented=represented)

    def _in_a_row(
        self, begins: Tensor, seen: Entries, sent: Tensor | None = None
    ) -> Iterator[Decision]:
        """The decisions of `unroll`, frame by frame."""
        feature = self.encode(seen[keys.OBSERVATION])
        time = begins.ndim - 2
        not_carried = [key for key in self.sees if key not in (keys.OBSERVATION, *self.carries)]
        carried: Entries = {key: seen[key].select(time, 0) for key in self.carries}
        for t in range(begins.shape[time]):
            if t > 0:
                carried = _begun_anew(carried, begins.select(time, t).squeeze(-1))
            now = {**{key: seen[key].select(time, t) for key in not_carried}, **carried}
            sent_now = None if sent is None else sent.select(time, t)
            decision = self.decide(feature.select(time, t), now, sent_now)
            carried = decision.carried
            yield decision

    def out(
        self, feature: Float[Tensor, "*batch agent joined"]
    ) -> Float[Tensor, "*batch agent out"]:
        """Return the head's outputs, none of them masked."""
        return self.head(feature)


class QNetwork(RobotsNetwork):
    """Values of every robot's actions.

    plain:   Q(o, a) = head(h')_a
    dueling: Q(o, a) = V(h') + A(h')_a - mean over a' of A(h')_a'      (arXiv 1511.06581)
    """

    def __init__(
        self,
        encoder: Encoder,
        comm: Comm,
        dueling: bool,
        precision: Precision,
        num_actions: int = NUM_ACTIONS,
        channels: Mapping[str, Channel] = MappingProxyType({}),
        mask_walls: bool = False,
    ) -> None:
        super().__init__(encoder, comm, num_actions + dueling, precision, channels, mask_walls)
        self.dueling = dueling

    def out(
        self, feature: Float[Tensor, "*batch agent joined"]
    ) -> Float[Tensor, "*batch agent action"]:
        value = self.head(feature)
        return duel(value) if self.dueling else value
