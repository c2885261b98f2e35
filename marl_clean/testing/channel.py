"""What every channel must hold, alone and in a stack."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from marl_clean.channel.base import Channel
from marl_clean.comm.base import BITS_PER_FLOAT, Comm, Senders, Talk
from marl_clean.learning.delivery import Stacked
from marl_clean.testing._broken import Clause, require, require_close, require_equal, verify
from marl_clean.testing._graphs import FEATURES, line, require_unheard, within
from marl_clean.testing._levels import Level, maker
from marl_clean.testing._talkers import Frames, Talkers, drawn_frames

Stack = Callable[[tuple[int, ...]], Sequence[Channel]]
"""From the message size of each round to channels, the first nearest to the sender."""


def check_channel(level: Level, **settings: Any) -> None:
    """A channel changes what is heard over live edges, and lets nothing cross dead ones.

        >>> check_channel("lossy", loss=0.5)

    A class gets `message_dims` where its constructor has this parameter. `check_stack` checks a
    stack.

    Raises:
        ContractBroken: what does not hold, with world, robots and numbers.
        BadInput: no such level or setting.
    """
    made = maker("channel", level, settings)
    check_stack(lambda dims: [made(message_dims=dims)], made.label)


def check_stack(stack: Stack, label: str = "channels") -> None:
    """A stack of channels holds the contract of a single channel.

    Raises:
        ContractBroken: what does not hold, with world, robots and numbers.
    """
    verify(label, CLAUSES, stack)


def made(stack: Stack, comm: Comm) -> list[Channel]:
    """Return channels for a scheme's messages, their own weights drawn at random."""
    channels = list(stack(tuple(comm.message_dims)))
    with torch.random.fork_rng([]):
        torch.manual_seed(1)
        for channel in channels:
            for weight in channel.double().parameters():
                nn.init.normal_(weight)
    return channels


def talked(channels: Sequence[Channel], comm: Comm, frames: Frames) -> list[Talk]:
    """Return the talk of each step; an episode begins with nothing carried."""
    batch, n_agents = frames.seed.shape[1:-1], frames.seed.shape[-1]
    specs = [
        channel.state_spec(n_agents, tuple(comm.message_dims)) if channel.remembers else None
        for channel in channels
    ]
    states = [None if spec is None else spec.zero(batch) for spec in specs]
    states = [s.double() if s is not None and s.is_floating_point() else s for s in states]
    draws = any(channel.draws for channel in channels)
    talks = []
    for feature, live, rank, seed in zip(*frames, strict=True):
        drawn = seed if draws else None
        delivery = Stacked(channels, live, rank, comm.rounds, drawn, states, comm.gated)
        require(not (delivery.sent & ~live).any(), "address sends over an edge that is not live")
        talks.append(comm(feature, live, Senders(rank), delivery))
        after = iter(delivery.states_after().values())
        states = [None if state is None else next(after) for state in states]
        for state, spec in zip(states, specs, strict=True):
            if state is not None and spec is not None:
                shape = [*batch, *spec.shape]
                kinds = f"{list(state.shape)}, not {shape}"
                require(list(state.shape) == shape, f"state_after is {kinds} as state_spec says")
    return talks


def features(talks: Sequence[Talk]) -> Tensor:
    """Return what robots know after each step."""
    return torch.stack([talk.feature for talk in talks])


def shapes_and_costs(stack: Stack) -> None:
    """Robots pay for what is sent, heard or not, at the price of the channel's numbers."""
    comm = Talkers((4, 3))
    channels = made(stack, comm)
    prices = [c.bits_per_number for c in channels if c.bits_per_number is not None]
    price = min(BITS_PER_FLOAT, *(prices[-1:] or [BITS_PER_FLOAT]))
    for batch in ((), (1,), (2, 3)):
        for n_agents in (1, 2, 5):
            frames = drawn_frames(3, *batch, n_agents=n_agents)
            for talk, live, rank in zip(
                talked(channels, comm, frames), frames.live, frames.rank, strict=True
            ):
                wanted, shape = [*batch, n_agents, FEATURES], list(talk.feature.shape)
                require(shape == wanted, f"what is known is {shape}, not {wanted}")
                sent = live
                for channel in channels:
                    sent = channel.address(sent, rank, comm.rounds)
                count = sent.sum(-2).unsqueeze(-1).double()
                require_equal(
                    talk.edges, count.expand(talk.edges.shape), "edges are not those sent"
                )
                require_equal(talk.bits, price * 7 * count, "bits are not those of what is sent")


def a_batch_equals_each_world_alone(stack: Stack) -> None:
    """A world's messages are what they are alone."""
    comm, frames = Talkers((4, 3)), drawn_frames(3, 4, n_agents=3)
    channels = made(stack, comm)
    together = features(talked(channels, comm, frames))
    for world in range(4):
        alone = features(talked(channels, comm, Frames(*(x[:, world] for x in frames))))
        broken = f"world {world} of 4 ([step, robot, number]) gives another result alone"
        require_close(together[:, world], alone, broken)


def relabelling_robots_and_draws_relabels_the_result(stack: Stack) -> None:
    """Nothing depends on how robots are numbered."""
    comm, frames = Talkers((4, 3)), drawn_frames(3, 6, n_agents=5)
    channels = made(stack, comm)
    order = torch.tensor([2, 0, 4, 1, 3])
    renamed = Frames(
        frames.feature[..., order, :],
        frames.live[..., order, :][..., order],
        frames.rank[..., order, :][..., order],
        frames.seed[..., order],
    )
    permuted = features(talked(channels, comm, frames))[..., order, :]
    broken = f"robots renumbered as {order.tolist()} get other results"
    require_close(permuted, features(talked(channels, comm, renamed)), broken)


def the_draws_alone_decide_the_result(stack: Stack) -> None:
    """What is random is a function of the draws that come with the frame, and of nothing else."""
    comm = Talkers((4, 3))
    channels, frames = made(stack, comm), drawn_frames(4, 40, n_agents=4, share=0.9)
    first = features(talked(channels, comm, frames))
    again = features(talked(channels, comm, frames))
    require_equal(first, again, "the same draws give another result")
    other = frames._replace(seed=drawn_frames(4, 40, n_agents=4, seed=1).seed)
    same = torch.equal(first, features(talked(channels, comm, other)))
    draws = any(channel.draws for channel in channels)
    require(same is not draws, "draws is True, but other draws give the same result")


def nothing_crosses_where_no_edge_was_ever_live(stack: Stack) -> None:
    """Nothing crosses an edge that was always dead: not even NaN, and no gradient."""
    for widths in ((5,), (4, 3)):
        comm, frames = Talkers(widths), drawn_frames(3, 6, n_agents=6, share=0.15)
        channels = made(stack, comm)
        reach = within(frames.live.cumsum(0) > 0, comm.rounds)
        before = features(talked(channels, comm, frames))
        for sender in range(0, 6, 2):
            deaf = ~reach[..., sender]
            inputs = frames.feature.clone().requires_grad_()
            now = features(talked(channels, comm, frames._replace(feature=inputs)))
            (back,) = torch.autograd.grad(now[deaf].sum(), inputs)
            grad = back[..., sender, :].abs().max().item()
            require(grad == 0, f"a gradient of {grad} crosses dead edges to robot {sender}")
            poisoned = frames.feature.clone()
            poisoned[..., sender, :] = torch.nan
            poisoned.requires_grad_()
            after = features(talked(channels, comm, frames._replace(feature=poisoned)))
            require_unheard(after, before, reach, sender, "NaN")
            (back,) = torch.autograd.grad(after[deaf].sum(), poisoned)
            untouched = ~within(frames.live.cumsum(0)[-1] > 0, 2 * comm.rounds)[..., sender]
            finite = back[:, untouched].isfinite()
            require(finite, f"NaN of robot {sender} crosses a dead edge in the gradient")


def no_further_than_the_rounds_and_no_later_than_declared(stack: Stack) -> None:
    """A message crosses an edge a round, and is heard at most `steps_late` steps later."""
    comm = Talkers((4, 3))
    channels = made(stack, comm)
    late = sum(channel.steps_late for channel in channels)
    live, (rank, _), hops = line(6)
    frames = drawn_frames(2 * late + 3, 8, n_agents=6)
    frames = frames._replace(live=live.expand_as(frames.live), rank=rank.expand_as(frames.rank))
    before = features(talked(channels, comm, frames))
    for sender in range(6):
        moved = frames.feature.clone()
        moved[:, :, sender] += 1
        changed = (features(talked(channels, comm, frames._replace(feature=moved))) != before).any(
            -1
        )
        farthest = int(hops[sender].masked_fill(~changed.flatten(0, 1).any(0), 0).max())
        require(farthest <= 2, f"what a robot knows crosses {farthest} edges in 2 rounds")
        moved = frames.feature.clone()
        moved[0, :, sender] += 1
        after = features(talked(channels, comm, frames._replace(feature=moved)))
        steps = (after != before).flatten(1).any(-1).nonzero()[:, 0]
        latest = int(steps.max()) if len(steps) else 0
        heard = f"what was sent is heard {latest} steps later; steps_late is {late} in all"
        require(latest <= comm.rounds * late, heard)


def nobody_hears_for_free(stack: Stack) -> None:
    """A robot's message of one step affects, then or later, no more robots than it pays for."""
    comm, frames = Talkers((5,)), drawn_frames(3, 20, n_agents=5, share=0.7)
    channels = made(stack, comm)
    talks = talked(channels, comm, frames)
    before = features(talks)
    for sender in range(5):
        moved = frames.feature.clone()
        moved[0, :, sender] = -2 * moved[0, :, sender] + 1
        after = features(talked(channels, comm, frames._replace(feature=moved)))
        heard = (after != before).any(-1).any(0)
        heard[:, sender] = False
        paid = talks[0].edges[:, sender].sum(-1)
        free = (heard.sum(-1) > paid).nonzero()[:, 0].tolist()
        where = f"robot {sender} in world {(free or [0])[0]}"
        require(not free, f"{where} is heard by more robots than it pays for")


def silence_is_heard_as_silence_and_costs_nothing(stack: Stack) -> None:
    """Where all robots choose to be silent, they know what they know without live edges."""
    comm, frames = Talkers((4, 3), gate=0.0), drawn_frames(4, 8, n_agents=4, share=0.9)
    channels = made(stack, comm)
    talks = talked(channels, comm, frames)
    alone = talked(channels, comm, frames._replace(live=torch.zeros_like(frames.live)))
    require_equal(features(talks), features(alone), "silent robots are heard")
    most = max(talk.bits.max().item() for talk in talks)
    require(most == 0, f"silent robots pay {most} bits")


CLAUSES: tuple[Clause, ...] = (
    shapes_and_costs,
    the_draws_alone_decide_the_result,
    a_batch_equals_each_world_alone,
    relabelling_robots_and_draws_relabels_the_result,
    nothing_crosses_where_no_edge_was_ever_live,
    no_further_than_the_rounds_and_no_later_than_declared,
    nobody_hears_for_free,
    silence_is_heard_as_silence_and_costs_nothing,
)
