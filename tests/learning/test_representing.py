"""What teaches a representation: its losses in plain loops, and what they reach."""

import pytest
import torch

from marl_clean import keys
from marl_clean.learning.acting import entries
from marl_clean.learning.grounding import GROUNDING
from marl_clean.learning.representing import PREDICTION, Reconstruction
from marl_clean.testing import check_agent
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
    part, grounding = agent.learnt[PREDICTION], agent.learnt[GROUNDING]
    network, target = agent.network, agent.target["network"]
    z = network(entries(network, batch)).talk.represented
    then = target(entries(target, batch["next"])).talk.represented
    reconstruct, predict = [], []
    for world in range(COUNT):
        observed = batch[keys.OBSERVATION][world].flatten(1)
        done = torch.nn.functional.one_hot(batch[keys.ACTION][world], 4).float()
        for i in range(N_AGENTS):
            around = [j for j in range(N_AGENTS) if batch[keys.ADJACENCY][world, i, j] or j == i]
            decoded = grounding.reconstruction.decoder(z[world, i])
            reconstruct += [(decoded - observed[j]).square().mean() for j in around]
            mean = torch.stack([part.done(done[j]) for j in around]).mean(0)
            foretold = z[world, i] + part.model(torch.cat([z[world, i], mean]))
            predict.append((foretold - then[world, i]).square().mean())
    grounding.weights["reconstruct"], part.weight = 2.0, 0.5
    expected = 2 * torch.stack(reconstruct).mean() + 0.5 * torch.stack(predict).mean()
    torch.testing.assert_close(agent.side_loss(batch)[0], expected)


@pytest.mark.long
def test_they_are_learnt_and_reach_the_senders():
    agent, batch = make_agent("masia", lr=1e-2, lr_end=1e-2), batch_of()
    before = agent.side_loss(batch)[0]
    (grad,) = torch.autograd.grad(before, agent.network.comm.message.weight)
    assert grad.any()
    for adjacency in (batch[keys.ADJACENCY], batch["next", keys.ADJACENCY]):
        adjacency.fill_(False)  # so that each has its own observation to hold, and can
    before = agent.side_loss(batch)[0]
    for _ in range(60):
        agent.update(batch.clone())
    assert agent.side_loss(batch)[0] < 0.5 * before
    beside = ("decoder", "prediction", "reconstruction")
    assert not any(part in name for name in agent.network.state_dict() for part in beside)


def test_with_places_it_is_asked_what_the_robot_there_sees():
    agent = make_agent("masia")
    agent.network.comm.places = True
    part = Reconstruction(agent.network.comm)
    assert part.decoder[0].in_features == agent.network.comm.represents + 4
    batch = batch_of()
    z = agent.network.comm.represents
    represented = torch.randn(COUNT, N_AGENTS, z)
    offset = torch.randint(-5, 6, (COUNT, N_AGENTS, N_AGENTS, 2))
    batch[keys.OFFSET] = offset
    loss = part(represented, batch)
    dead = ~batch[keys.ADJACENCY]
    batch[keys.OFFSET] = torch.where(dead.unsqueeze(-1), 99, offset)
    torch.testing.assert_close(part(represented, batch), loss)  # dead edges are unseen
    batch[keys.OFFSET] = torch.where(dead.unsqueeze(-1), offset, offset + 1)
    assert part(represented, batch) != loss


@pytest.mark.parametrize(
    ("learner", "scheme"),
    [("vdn", "masia"), ("iql", "expocomm"), ("pqn", "masia"), ("ippo", "expocomm")],
)
def test_every_learner_reconstructs_and_a_resumed_run_has_its_decoder(learner, scheme):
    agent = make_learner(learner, scheme)
    decoder = agent.grounding.reconstruction.decoder
    assert decoder[-1].out_features == SIDE**2
    assert any(weight is decoder[0].weight for weight in agent._parameters)
    with torch.no_grad():
        for weight in decoder.parameters():
            weight.normal_()
    other = make_learner(learner, scheme)
    other.load_state_dict(agent.state_dict())
    for mine, theirs in zip(
        agent.grounding.parameters(), other.grounding.parameters(), strict=True
    ):
        assert torch.equal(mine, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["iql", "pqn", "ippo"])
def test_what_is_remembered_is_taught_over_frames_in_a_row(learner):
    check_agent(learner, comm="expocomm", precision="float32")


def test_schemes_that_represent_nothing_have_no_such_parts():
    learnt = make_agent("plan").learnt
    assert PREDICTION not in learnt and GROUNDING not in learnt
