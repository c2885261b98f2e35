"""What every communication scheme must hold."""

from operator import itemgetter
from typing import Any

import torch
from torch import Tensor

from marl_clean.comm._decoding import Decoding
from marl_clean.comm.base import Comm, Talk
from marl_clean.testing import _choosers, _decoding, _hearers
from marl_clean.testing._broken import (
    Clause,
    require,
    require_close,
    verify,
)
from marl_clean.testing._graphs import (
    FEATURES,
    draw,
    each,
    line,
    of_robots,
    require_unheard,
    within,
)
from marl_clean.testing._hearers import TALK
from marl_clean.testing._levels import Level, Maker, maker
from marl_clean.testing._reminded import reminded

OBSERVED = 50  # numbers in an observation, for schemes that send or reconstruct those


def check_comm(level: Level, *, compiled: bool = False, **settings: Any) -> None:
    """A scheme communicates over live edges only, and pays for what it sends.

        >>> check_comm("tarmac", rounds=2)

    A class gets `in_features`, and `observed` where its constructor has this parameter.

    Args:
        level: its name, as on the command line, or its class.
        compiled: compare it with itself compiled by `torch.compile` in one graph, too.
        settings: of the level, instead of its yaml's.

    Raises:
        ContractBroken: what does not hold, with world, robots and numbers.
        BadInput: no such level or setting.
    """
    made = maker("comm", level, settings)
    verify(made.label, (*CLAUSES, compiled_it_is_the_same) if compiled else CLAUSES, made)


def make_scheme(make: Maker) -> Comm:
    """Return the scheme in double precision as it is used, with weights drawn from seed 0."""
    with torch.random.fork_rng([]):
        torch.manual_seed(0)
        comm = make(in_features=FEATURES, observed=OBSERVED).double().eval()
        return reminded(comm)


def shapes(make: Maker) -> None:
    """A talk has a feature, message, edges and bits of each robot, whatever the batch."""
    comm = make_scheme(make)
    for batch in ((), (1,), (5,), (2, 3)):
        for n_agents in (1, 2, 5):
            talk = comm(*draw(*batch, n_agents=n_agents))
            words = sum(comm.message_dims[: comm.rounds])
            widths = (comm.out_features, words, comm.rounds, 1)
            for name, entry, width in zip(TALK, talk[:4], widths, strict=True):
                wanted, shape = [*batch, n_agents, width], list(entry.shape)
                require(shape == wanted, f"{name} is {shape}, not {wanted}")


def relabelling_the_robots_relabels_the_result(make: Maker) -> None:
    """Nothing depends on how robots are numbered."""
    comm = make_scheme(make)
    for n_agents, numbers in ((2, [1, 0]), (3, [2, 0, 1]), (6, [3, 0, 5, 1, 4, 2])):
        feature, live, senders = draw(4, n_agents=n_agents)
        order = torch.tensor(numbers)
        renamed = comm(feature[:, order], live[:, order][..., order], of_robots(senders, order))
        _require_same(
            comm(feature, live, senders), renamed, order, f"robots renumbered as {numbers}"
        )


def a_dead_edge_has_no_influence_not_even_nan_and_no_gradient(make: Maker) -> None:
    """Nothing crosses a dead edge: no number, not even NaN, and no gradient."""
    comm = make_scheme(make)
    feature, live, senders = draw(6, n_agents=5, share=0.3)
    reach, before = within(live, comm.rounds), comm(feature, live, senders).feature
    for sender in range(5):
        deaf = ~reach[:, :, sender]
        inputs = feature.clone().requires_grad_()
        (back,) = torch.autograd.grad(comm(inputs, live, senders).feature[deaf].sum(), inputs)
        grad = back[:, sender].abs().max().item()
        require(grad == 0, f"a gradient of {grad} crosses dead edges to robot {sender}")
        poisoned = feature.clone()
        poisoned[:, sender] = torch.nan
        poisoned.requires_grad_()
        after = comm(poisoned, live, senders).feature
        require_unheard(after, before, reach, sender, "NaN")
        (back,) = torch.autograd.grad(after[deaf].sum(), poisoned)
        # A robot that hears the poisoned sender passes 0 x NaN back to its senders, and no further.
        untouched = ~within(live, 2 * comm.rounds)[:, :, sender]
        finite = back[untouched].isfinite()
        require(finite, f"NaN of robot {sender} crosses a dead edge in the gradient")


def an_offset_over_a_dead_edge_has_no_influence(make: Maker) -> None:
    """Where a robot is, only robots in contact with it may know, and only if the scheme asks."""
    _hearers.offsets_over_dead_edges_have_no_influence(make_scheme(make))


def where_a_sender_is_reaches_its_hearer(make: Maker) -> None:
    """With `places`, row and col of a sender seen from its hearer reach the hearer, no others."""
    _hearers.a_sender_elsewhere_is_heard_elsewhere(make_scheme(make))


def turning_the_house_matters_only_with_places(make: Maker) -> None:
    """A house turned by quarters is another house with `places`, and the same without."""
    _hearers.turning_the_house_matters_only_with_places(make_scheme(make))


def who_hears_nothing_keeps_its_features_to_the_bit(make: Maker) -> None:
    """With `join=residual` or `gated` a robot without live edge keeps its features, to the bit."""
    _hearers.who_hears_nothing_keeps_its_features(make_scheme(make))


def gradient_crosses_exactly_the_edges_within_the_rounds(make: Maker) -> None:
    """A robot's loss reaches itself and, unless messages are detached, its senders; no others."""
    comm = make_scheme(make)
    feature, live, senders = draw(4, n_agents=4, share=0.4)
    feature.requires_grad_()
    with torch.random.fork_rng([]):
        torch.manual_seed(0)
        talk = comm.train()(feature, live, senders)  # in eval mode bits and gates have no gradient
    reach, itself = within(live, comm.rounds), torch.eye(4, dtype=torch.bool)
    crosses = talk.message.shape[-1] > 0 and not comm.detach
    ever = False
    for world in range(4):
        for receiver in range(4):
            loss = talk.feature[world, receiver].sum()
            (grad,) = torch.autograd.grad(loss, feature, retain_graph=True)
            touched = grad.abs().sum(-1).ne(0)
            where = f"the loss of robot {receiver} in world {world}"
            require(touched[world, receiver], f"{where} does not reach its own features")
            other_worlds = touched[torch.arange(4) != world]
            require(not other_worlds.any(), f"{where} reaches another world")
            allowed = reach[world, receiver] if crosses else itself[receiver]
            wrong = (touched[world] & ~allowed).nonzero()[:, 0].tolist()
            why = "not within its rounds of live edges" if crosses else "though detached"
            require(not wrong, f"{where} reaches robots {wrong}, {why}")
            others = allowed & ~itself[receiver]
            reached = bool(touched[world][others].any()) or not others.any()
            ever |= bool(touched[world][others].any())
            require(
                reached or comm.chooses,
                f"{where} reaches none of {others.nonzero()[:, 0].tolist()}",
            )
    require(ever or not crosses, "no loss of any robot reaches another")


def rounds_reach_as_many_hops_and_no_further(make: Maker) -> None:
    """Information crosses as many edges within a step as there are rounds."""
    comm = make_scheme(make)
    length = comm.rounds + 3
    live, senders, hops = line(length)
    live, senders = live.expand(16, -1, -1), each(senders, lambda x: x.expand(16, *x.shape))
    feature = draw(16, n_agents=length)[0]
    before = comm(feature, live, senders).feature
    farthest = 0
    for sender in range(length):
        moved = feature.clone()
        moved[:, sender] += 1
        changed = (comm(moved, live, senders).feature != before).any(-1).any(0)
        farthest = max(farthest, int(hops[sender].masked_fill(~changed, 0).max()))
    reached = f"what a robot knows crosses {farthest} edges in {comm.rounds} rounds"
    fewer = comm.chooses and 0 < farthest < comm.hops  # some edge on the line may not be chosen
    require(farthest == comm.hops or fewer, reached)


def without_live_edge_the_others_may_be_anyone_or_missing(make: Maker) -> None:
    """A robot that no other reaches knows what it would know alone in the world."""
    comm = make_scheme(make)
    feature, live, senders = draw(3, n_agents=4, share=0.0)
    itself = of_robots(senders, torch.tensor([0]))
    alone = comm(feature[:, :1], live[:, :1, :1], itself).feature
    among = comm(feature, live, senders).feature[:, :1]
    require_close(among, alone, "with no live edge, robot 0 of 4 has other features than alone")


def a_batch_equals_each_world_alone(make: Maker) -> None:
    """A world's talk is what it is alone."""
    comm = make_scheme(make)
    feature, live, senders = draw(5, n_agents=3)
    together = comm(feature, live, senders)
    for world in range(5):
        alone = comm(feature[world], live[world], each(senders, itemgetter(world)))
        for name, batched, single in zip(TALK, together[:4], alone[:4], strict=True):
            require_close(batched[world], single, f"{name} of world {world} of 5 differs alone")


def bits_are_those_of_the_numbers_sent(make: Maker) -> None:
    """A robot pays for each live edge, round and number of what it sends, silence aside."""
    comm = make_scheme(make)
    sends_observation = make.takes("observed") and not comm.represents  # else it reconstructs it
    _choosers.bits_are_those_sent(comm, OBSERVED if sends_observation else None)


def nothing_crosses_an_edge_that_a_robot_does_not_choose(make: Maker) -> None:
    """Where a robot chooses to whom it sends, no other hears it, and not even NaN arrives."""
    _choosers.nothing_crosses_what_is_not_chosen(make_scheme(make))


def what_a_robot_sends_depends_on_nobody_out_of_reach(make: Maker) -> None:
    """A message depends on no robot that earlier rounds do not connect with its sender."""
    comm = make_scheme(make)
    feature, live, senders = draw(6, n_agents=5, share=0.3)
    reach = within(live, max(0, comm.rounds - 1))
    before = comm(feature, live, senders).message
    for robot in range(5):
        moved = feature.clone()
        moved[:, robot] += 1
        after = comm(moved, live, senders).message
        require_unheard(after, before, reach, robot, "in a message, a feature")


def robots_out_of_reach_change_nothing_unless_it_dilutes(make: Maker) -> None:
    """Adding robots that no other reaches changes nothing, unless the scheme says it dilutes."""
    comm = make_scheme(make)
    feature, live, senders = draw(3, n_agents=5, share=0.7)
    live[:, 2], live[:, :, 2] = False, False
    kept = torch.tensor([0, 1, 3, 4])
    without = comm(feature[:, kept], live[:, kept][..., kept], of_robots(senders, kept))
    among = comm(feature, live, senders)
    if comm.dilutes:
        same = torch.equal(among.feature[:, kept], without.feature)
        require(not same, "dilutes is True, but another robot out of reach changes nothing")
        return
    _require_same(among, without, kept, "without robot 2, which no other reaches,")


def attention_is_paid_over_live_edges(make: Maker) -> None:
    """Where a scheme attends, the weights are shares, and none falls on a dead edge."""
    _hearers.attention_is_paid_over_live_edges(make_scheme(make))


def what_is_read_is_told_over_live_edges(make: Maker) -> None:
    """What a scheme reads in messages is a class a cell, of live edges, and nothing of silence."""
    _decoding.what_is_read_is_told_over_live_edges(make_scheme(make))


def every_weight_learns(make: Maker) -> None:
    """Every weight gets a gradient."""
    comm = make_scheme(make).train()
    if not list(comm.parameters()):
        return
    talk = comm(*draw(4, n_agents=4))
    (_decoding.code_loss(comm) if isinstance(comm, Decoding) else talk.feature.sum()).backward()
    for name, weight in comm.named_parameters():
        require(weight.grad is not None, f"{name} gets no gradient")


def compiled_it_is_the_same(make: Maker) -> None:
    """Compiled by `torch.compile` into one graph, it gives the same."""
    comm, inputs = make_scheme(make), draw(4, n_agents=3)
    torch.compiler.reset()
    compiled = torch.compile(comm, fullgraph=True, backend="eager")(*inputs)
    for name, eager, result in zip(TALK, comm(*inputs)[:4], compiled[:4], strict=True):
        require_close(result, eager, f"compiled, {name} differs", tolerance=1e-9)


def _require_same(talk: Talk, renamed: Talk, robots: Tensor, what: str) -> None:
    for name, before, after in zip(TALK, talk[:4], renamed[:4], strict=True):
        require_close(before[:, robots], after, f"{what} it has another {name}")


CLAUSES: tuple[Clause, ...] = (
    shapes,
    relabelling_the_robots_relabels_the_result,
    a_dead_edge_has_no_influence_not_even_nan_and_no_gradient,
    an_offset_over_a_dead_edge_has_no_influence,
    where_a_sender_is_reaches_its_hearer,
    turning_the_house_matters_only_with_places,
    who_hears_nothing_keeps_its_features_to_the_bit,
    gradient_crosses_exactly_the_edges_within_the_rounds,
    rounds_reach_as_many_hops_and_no_further,
    without_live_edge_the_others_may_be_anyone_or_missing,
    a_batch_equals_each_world_alone,
    bits_are_those_of_the_numbers_sent,
    nothing_crosses_an_edge_that_a_robot_does_not_choose,
    what_a_robot_sends_depends_on_nobody_out_of_reach,
    robots_out_of_reach_change_nothing_unless_it_dilutes,
    attention_is_paid_over_live_edges,
    what_is_read_is_told_over_live_edges,
    every_weight_learns,
)
