"""What every channel must hold, as checks that a stack of channels passes or fails."""

from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from omegaconf import OmegaConf
from torch import Tensor

from marl_clean.channel.base import Channel
from marl_clean.config.schema import instantiate, takes
from marl_clean.learning.delivery import Stacked
from tests.comm.contract import draw, make, within

CONF = Path(__file__).parents[2] / "conf" / "channel"
LEVELS = sorted(path.stem for path in CONF.glob("*.yaml"))
Stack = list[Channel]
Make = Callable[[tuple[int, ...]], Stack]


def channel(level: str, dims: tuple[int, ...], **changes) -> Channel:
    section = OmegaConf.merge(OmegaConf.load(CONF / f"{level}.yaml"), changes)
    parts = {"message_dims": dims} if takes(section["_target_"], "message_dims") else {}
    torch.manual_seed(0)
    made = instantiate(section, **parts).double()
    for weight in made.parameters():
        torch.nn.init.normal_(weight)
    return made


def seeds(*batch: int, n_agents: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(2**32, (*batch, n_agents), generator=generator)


def states(stack: Stack, dims: tuple[int, ...], live: Tensor, seed: int = 3) -> list:
    """What each channel carries, filled as steps before would have: other messages, other edges."""
    made = []
    generator = torch.Generator().manual_seed(seed)
    batch, n_agents = live.shape[:-2], live.shape[-1]
    for one in stack:
        if one.remembers is None:
            made.append(None)
            continue
        spec = one.state_spec(n_agents, dims)
        shape = (*batch, *spec.shape)
        if spec.dtype == torch.bool:
            made.append(torch.rand(shape, generator=generator) < 0.5)
            continue
        words = sum(dims)
        message = torch.randn(*shape[:-1], words, generator=generator, dtype=torch.float64)
        reaches = live.mT.unsqueeze(-2).expand(*shape[:-1], n_agents).double()
        made.append(torch.cat([message, reaches], dim=-1))
    return made


def cross(stack: Stack, comm, feature, live, rank, seed, carried) -> tuple:
    delivery = Stacked(stack, live, rank, comm.rounds, seed, carried)
    return comm(feature, live, rank, delivery), delivery


def shapes_and_costs(stack: Make) -> None:
    comm = make("commnet")
    channels = stack(tuple(comm.message_dims))
    for batch in ((), (1,), (2, 3)):
        for n_agents in (1, 2, 5):
            feature, live, rank = draw(*batch, n_agents=n_agents)
            carried = states(channels, tuple(comm.message_dims), live)
            seed = seeds(*batch, n_agents=n_agents)
            talk, delivery = cross(channels, comm, feature, live, rank, seed, carried)
            assert talk.feature.shape == (*batch, n_agents, comm.out_features)
            kept = [state for state in carried if state is not None]
            for before, after in zip(kept, delivery.states_after(), strict=True):
                assert before.shape == after.shape and before.dtype == after.dtype
            assert not (delivery.sent & ~live).any()
            bits = next((w.bits_per_number for w in reversed(channels) if w.bits_per_number), 32)
            sent = delivery.sent.sum(-2).unsqueeze(-1).double()
            assert torch.equal(talk.bits, bits * sum(comm.message_dims) * sent)
            assert torch.equal(talk.edges, sent.expand(talk.edges.shape))


def a_batch_is_its_worlds_one_by_one(stack: Make) -> None:
    comm = make("commnet")
    dims = tuple(comm.message_dims)
    channels = stack(dims)
    feature, live, rank = draw(5, n_agents=4)
    carried, seed = states(channels, dims, live), seeds(5, n_agents=4)
    together, _ = cross(channels, comm, feature, live, rank, seed, carried)
    for world in range(5):
        alone_carried = [None if state is None else state[world] for state in carried]
        alone, _ = cross(
            channels, comm, feature[world], live[world], rank[world], seed[world], alone_carried
        )
        torch.testing.assert_close(together.feature[world], alone.feature)


def the_same_seeds_give_the_same_and_others_another(stack: Make) -> None:
    comm = make("commnet")
    dims = tuple(comm.message_dims)
    channels = stack(dims)
    feature, live, rank = draw(40, n_agents=4, share=0.9)
    carried = states(channels, dims, live)

    def result(seed: int) -> list[Tensor]:
        drawn = seeds(40, n_agents=4, seed=seed)
        talk, delivery = cross(channels, comm, feature, live, rank, drawn, carried)
        return [talk.feature, *delivery.states_after()]

    def same(mine: list[Tensor], theirs: list[Tensor]) -> bool:
        return all(torch.equal(a, b) for a, b in zip(mine, theirs, strict=True))

    assert same(result(0), result(0))
    assert same(result(0), result(1)) is not any(each.draws for each in channels)


def a_dead_edge_stays_dead_not_even_nan_crosses(stack: Make) -> None:
    comm = make("commnet", rounds=1)
    dims = tuple(comm.message_dims)
    channels = stack(dims)
    feature, live, rank = draw(6, n_agents=5, share=0.3)
    carried, seed = states(channels, dims, live), seeds(6, n_agents=5)
    before = cross(channels, comm, feature, live, rank, seed, carried)[0].feature
    for sender in range(5):
        deaf = ~within(live, 1)[:, :, sender]
        poisoned = feature.clone()
        poisoned[:, sender] = torch.nan
        poisoned.requires_grad_()
        after = cross(channels, comm, poisoned, live, rank, seed, carried)[0].feature
        assert torch.equal(after[deaf], before[deaf])
        inputs = feature.clone().requires_grad_()
        cross(channels, comm, inputs, live, rank, seed, carried)[0].feature[deaf].sum().backward()
        assert not inputs.grad[:, sender].any()


def no_further_than_the_rounds(stack: Make) -> None:
    comm = make("commnet", rounds=2)
    dims = tuple(comm.message_dims)
    channels = stack(dims)
    place = torch.arange(6)
    rank = (place - place[:, None]).abs().mul(2).add(place > place[:, None]).argsort(-1).argsort(-1)
    live = (place - place[:, None]).abs() == 1
    feature = draw(n_agents=6)[0]
    carried, seed = states(channels, dims, live), seeds(n_agents=6)
    before = cross(channels, comm, feature, live, rank, seed, carried)[0].feature
    for sender in range(6):
        moved = feature.clone()
        moved[sender] += 1
        after = cross(channels, comm, moved, live, rank, seed, carried)[0].feature
        assert not (after != before).any(-1)[(place - sender).abs() > 2].any()


CONTRACT: Sequence[Callable[[Make], None]] = (
    shapes_and_costs,
    a_batch_is_its_worlds_one_by_one,
    the_same_seeds_give_the_same_and_others_another,
    a_dead_edge_stays_dead_not_even_nan_crosses,
    no_further_than_the_rounds,
)
