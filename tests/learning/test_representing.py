"""What teaches a representation: its losses in plain loops, and what they reach."""

import pytest
import torch

from marl_clean import keys
from marl_clean.learning.acting import entries
from marl_clean.learning.representing import REPRESENTATION
from tests.agent.parts import SIDE, make_agent, make_learner, transitions

COUNT, N_AGENTS = 4, 3


def batch_of(count: int = COUNT, n_agents: int = N_AGENTS):
    batch = transitions(count, n_agents)
    assert 0 < batch[keys.ADJACENCY].sum() < batch[keys.ADJACENCY].numel()
    return batch


def test_losses_are_their_equations():
    agent, batch = make_agent("masia"), batch_of()
    with torch.no_grad():
        for weight in agent.target.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    part = agent.learnt[REPRESENTATION]
    network, target = agent.network, agent.target["network"]
    z = network(entries(network, batch)).talk.represented
    then = target(entries(target, batch["next"])).talk.represented
    reconstruct, predict = [], []
    for world in range(COUNT):
        observed = batch[keys.OBSERVATION][world].flatten(1)
        done = torch.nn.functional.one_hot(batch[keys.ACTION][world], 4).float()
        for i in range(N_AGENTS):
            around = [j for j in range(N_AGENTS) if batch[keys.ADJACENCY][world, i, j] or j == i]
            decoded = part.decoder(z[world, i])
            reconstruct += [(decoded - observed[j]).square().mean() for j in around]
            mean = torch.stack([part.done(done[j]) for j in around]).mean(0)
            foretold = z[world, i] + part.model(torch.cat([z[world, i], mean]))
            predict.append((foretold - then[world, i]).square().mean())
    agent.network.comm.pull = 0.0
    part.weights = {"reconstruct": 2.0, "predict": 0.5}
    expected = 2 * torch.stack(reconstruct).mean() + 0.5 * torch.stack(predict).mean()
    torch.testing.assert_close(agent.side_loss(batch)[0], expected)


def test_they_are_learnt_and_reach_the_senders():
    agent, batch = make_agent("masia", lr=1e-2, lr_end=1e-2), batch_of()
    plain = make_agent("masia")
    plain.learnt[REPRESENTATION].weights = {"reconstruct": 0.0, "predict": 0.0}
    loss = plain.loss(batch)
    torch.testing.assert_close(agent.loss(batch), loss)
    before = agent.side_loss(batch)[0]
    (grad,) = torch.autograd.grad(before, agent.network.comm.message.weight)
    assert grad.any()
    for adjacency in (batch[keys.ADJACENCY], batch["next", keys.ADJACENCY]):
        adjacency.fill_(False)  # so that each has its own observation to hold, and can
    before = agent.side_loss(batch)[0]
    for _ in range(60):
        agent.update(batch.clone())
    assert agent.side_loss(batch)[0] < 0.5 * before
    assert not any("representation" in name for name in agent.network.state_dict())


def test_with_places_it_is_asked_what_the_robot_there_sees():
    agent = make_agent("masia")
    agent.network.comm.places = True
    part = type(agent.learnt[REPRESENTATION])(agent.network.comm, 4)
    assert part.decoder[0].in_features == agent.network.comm.represents + 4
    batch = batch_of()
    z = agent.network.comm.represents
    represented = torch.randn(COUNT, N_AGENTS, z)
    offset = torch.randint(-5, 6, (COUNT, N_AGENTS, N_AGENTS, 2))
    batch[keys.OFFSET] = offset
    loss = part.reconstruct(represented, batch)
    dead = ~batch[keys.ADJACENCY]
    batch[keys.OFFSET] = torch.where(dead.unsqueeze(-1), 99, offset)
    torch.testing.assert_close(part.reconstruct(represented, batch), loss)  # dead edges are unseen
    batch[keys.OFFSET] = torch.where(dead.unsqueeze(-1), offset, offset + 1)
    assert part.reconstruct(represented, batch) != loss


@pytest.mark.parametrize(("learner", "scheme"), [("vdn", "masia"), ("iql", "expocomm")])
def test_a_resumed_run_has_its_decoders(learner, scheme):
    agent = make_learner(learner, scheme)
    assert agent.learnt[REPRESENTATION].decoder[-1].out_features == SIDE**2
    with torch.no_grad():
        for weight in agent.learnt[REPRESENTATION].parameters():
            weight.normal_()
    other = make_learner(learner, scheme)
    other.load_state_dict(agent.state_dict())
    mine, theirs = (one.learnt[REPRESENTATION].state_dict() for one in (agent, other))
    assert all(torch.equal(mine[name], theirs[name]) for name in mine)


def test_schemes_that_represent_nothing_have_no_such_part():
    assert REPRESENTATION not in make_agent("plan").learnt
