"""Messages learn to tell what their sender knows: targets, losses, and who learns from them."""

import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from omegaconf import OmegaConf

from marl_clean import build, keys
from marl_clean.comm.base import Talk
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.fitting import check_fit
from marl_clean.env.known_cells import KnownCells
from marl_clean.errors import BadInput
from marl_clean.learning.grounding import Grounding, ground_loss
from marl_clean.learning.symmetry import NUM_SYMMETRIES, rotate_frames_
from marl_clean.settings import Ground
from tests.agent.parts import collected, make_comm, make_encoder
from tests.world.play import env_of, start
from tests.world.strategies import Case, cases

SMALL = [
    "train_houses=8",
    "house.rows=[5,6]",
    "house.cols=[5,7]",
    "env.num_envs=6",
    "env.n_agents=3",
    "env.memory=private",
    "encoder=mlp",
    "observation=compass",
    "encoder.hidden=[32]",
    "topology=full",
]
BOTH = ["comm.ground.sender_map=0.5", "comm.ground.missing=2.0"]
LEARNERS = {
    "pqn": ["agent=pqn", "trainer=on_policy"],
    "ippo": ["agent=ippo", "trainer=on_policy"],
    "mappo": ["agent=mappo", "trainer=on_policy", "agent.critic=state"],
    "iql": ["agent=iql", "agent.augment=false"],
    "vdn": ["agent=vdn", "agent.augment=false", "reward=team"],
}


def class_of(world, robot: int, place) -> int:
    """0 unknown, 1 blocked, 2 never cleaned, 3 cleaned, by the plain reference's map."""
    held = world.map_of(robot).get(place)
    if held is None:
        return 0
    return 1 if held.blocked else 2 if held.cleaned is None else 3


def square(world, robot: int, around: int) -> list[list[int]]:
    row, col = world.positions[around]
    cells = range(-3, 4)
    return [
        [class_of(world, robot, (row + down, col + right)) for right in cells] for down in cells
    ]


@pytest.mark.slow
@given(case=cases())
@hypothesis_settings(max_examples=25, deadline=None)
def test_targets_are_those_of_the_reference(case: Case) -> None:
    env = env_of([case])
    env.append_transform(KnownCells(sender_map=True, missing=True))
    world, tensordict = case.world(), start(env, [case])
    robots = range(len(world.positions))
    for actions in case.actions:
        own = [square(world, i, i) for i in robots]
        assert tensordict[keys.KNOWN][0].tolist() == own
        for i in robots:
            for j in robots:
                of_j = square(world, j, i)
                wanted = [
                    [-1 if mine else theirs for mine, theirs in zip(*lines, strict=True)]
                    for lines in zip(own[i], of_j, strict=True)
                ]
                assert tensordict[keys.MISSING][0, i, j].tolist() == wanted
        tensordict[keys.ACTION] = torch.tensor([actions])
        tensordict = env.step(tensordict)["next"]
        outcome = world.step(actions)
        if outcome.terminated or outcome.truncated:
            break


@pytest.mark.slow
def test_nothing_is_added_unless_asked_for_nor_in_evaluation() -> None:
    for settings, shaped, wanted in (([], True, False), (BOTH, True, True), (BOTH, False, False)):
        cfg = compose_config([*SMALL, "comm=plan", *settings])
        held = build.make_env(cfg, shaped=shaped).reset().keys(True)
        assert [key in held for key in (keys.KNOWN, keys.MISSING, keys.OFFSET)] == [wanted] * 3


def grounded() -> Grounding:
    comm = make_comm("plan", make_encoder())
    comm.ground = Ground(sender_map=1.0, missing=1.0)
    torch.manual_seed(3)
    return Grounding(comm)


@pytest.mark.slow
def test_the_losses_are_their_equations() -> None:
    part = grounded()
    frames = collected([*SMALL, "comm=plan", *LEARNERS["pqn"], *BOTH])[1][0, :6]
    n = 3
    live = torch.tensor([[0, 1, 0], [1, 0, 0], [0, 0, 0]], dtype=torch.bool)
    frames[keys.ADJACENCY] = live.expand(6, n, n).contiguous()
    message = torch.randn(6, n, 32)
    talk = Talk(message, message, live.sum(-2).float().expand(6, n).unsqueeze(-1), message)
    losses = part.losses(talk, frames)
    by_map, by_missing = [], []
    for t in range(6):
        for j in (0, 1):  # robot 2 speaks to nobody
            logits = part.decoders["sender_map"](message[t, j]).log_softmax(-1)
            target = frames[keys.KNOWN][t, j].long()
            by_map.append(-logits.gather(-1, target.unsqueeze(-1)).flatten())
            i = 1 - j
            row, col = frames[keys.OFFSET][t, i, j].tolist()
            place = torch.tensor([row, col, abs(row), abs(col)]) / 10
            logits = part.decoders["missing"](torch.cat([message[t, j], place])).log_softmax(-1)
            target = frames[keys.MISSING][t, i, j].long()
            new = target >= 0
            assert new.any() and not new.all()
            by_missing.append(-logits[new].gather(-1, target[new].unsqueeze(-1)).flatten())
    torch.testing.assert_close(losses["sender_map"], torch.cat(by_map).mean())
    torch.testing.assert_close(losses["missing"], torch.cat(by_missing).mean())


@pytest.mark.slow
@pytest.mark.parametrize("learner", LEARNERS)
def test_learners_learn_from_them_and_log_them(learner: str) -> None:
    agent, block = collected([*SMALL, "comm=plan", *LEARNERS[learner], *BOTH], steps=8)
    assert not any("decoder" in name for name in agent.network.state_dict())
    decoders = {name: w.clone() for name, w in agent.grounding.named_parameters()}
    if learner in ("iql", "vdn"):
        batch = block.flatten(0, 1)
        batch[keys.STEPS_TO_NEXT_OBS] = torch.ones(len(batch), dtype=torch.int64)
    else:
        batch = agent.estimate(block).flatten(0, 1)
    measures = agent.update(batch)
    assert {"ground_sender_map", "ground_missing"} <= set(measures)
    assert all(1 < measures[f"ground_{name}"] < 2 for name in ("sender_map", "missing"))
    for name, weight in agent.grounding.named_parameters():
        assert not torch.equal(weight, decoders[name]), name
    other, _ = collected([*SMALL, "comm=plan", *LEARNERS[learner], *BOTH], steps=1)
    other.load_state_dict(agent.state_dict())
    torch.testing.assert_close(other.grounding.state_dict(), agent.grounding.state_dict())


@pytest.mark.slow
@pytest.mark.parametrize("only", [False, True])
def test_messages_may_learn_from_these_losses_alone(only: bool) -> None:
    """The receivers' loss reaches what makes messages, unless they are grounded alone."""
    settings = [*SMALL, "comm=plan", *LEARNERS["pqn"], *BOTH, f"comm.ground.only={only}"]
    agent, block = collected(settings, steps=4)
    batch, speaks = agent.estimate(block).flatten(0, 1), agent.network.comm.message[0].weight
    agent.network.zero_grad()
    agent.loss(batch).backward()
    reached = speaks.grad is not None and bool(speaks.grad.any())
    assert reached is not only
    agent.network.zero_grad()
    talk = agent.network.talks({key: batch[key] for key in agent.network.sees})
    agent.grounding.weighted(agent.grounding.losses(talk, batch)).backward()
    assert speaks.grad.any()
    assert any(weight.grad.any() for weight in agent.network.encoder.parameters())


@pytest.mark.long
@pytest.mark.parametrize("memory", ["none", "gru"])
def test_grounded_messages_come_to_tell_the_senders_map(memory: str) -> None:
    """Beyond what each cell is most often, by these losses alone; with a memory in rows."""
    settings = [*SMALL, "comm=plan", *LEARNERS["ippo"], *BOTH, f"encoder.memory={memory}"]
    agent, block = collected([*settings, "env.sensor=touch4"], steps=24)
    batch = block if memory == "gru" else block.flatten(0, 1)
    learnt = torch.optim.Adam([*agent.network.parameters(), *agent.grounding.parameters()], 0.01)
    told = []
    for _ in range(50):
        loss, measures = ground_loss(agent.grounding, agent.network, batch)
        told.append(measures["ground_sender_map"])
        learnt.zero_grad()
        loss.backward()
        learnt.step()
    known = batch[keys.KNOWN].flatten(0, -3)
    shares = torch.stack([(known == c).double().mean(0) for c in range(4)])  # of each cell
    without_messages = -(shares * shares.clamp(min=1e-9).log()).sum(0).mean()
    assert told[-1] < 0.8 * without_messages < told[0]


@pytest.mark.slow
def test_targets_rotate_with_offsets() -> None:
    """The cell that an offset leads to is the same cell in a rotated frame."""
    _, block = collected([*SMALL, "comm=plan", *LEARNERS["pqn"], *BOTH], steps=8)
    frames = block.flatten(0, 1)[: 5 * NUM_SYMMETRIES].select(
        keys.KNOWN, keys.MISSING, keys.OFFSET, keys.ACTION
    )
    squares = torch.randn(len(frames), 3, 1, 7, 7)
    for part in (frames, frames.setdefault("next", frames.select(keys.OFFSET))):
        part[keys.OBSERVATION] = squares.clone()
        part[keys.OFFSET] = part[keys.OFFSET].clamp(-3, 3)
    before = frames.clone()
    rotate_frames_(frames)

    def at(part, key):
        row, col = (part[keys.OFFSET][:, 0, 1] + 3).unbind(-1)
        entry = part[key][:, 0]
        frame = torch.arange(len(entry))
        return entry[frame, 1, row, col] if key == keys.MISSING else entry[frame, row, col]

    assert not torch.equal(before[keys.KNOWN], frames[keys.KNOWN])
    for key in (keys.KNOWN, keys.MISSING):
        assert torch.equal(at(before, key), at(frames, key))


def test_by_default_runs_keep_their_hash() -> None:
    cfg = compose_config(["comm=tarmac"])
    earlier = OmegaConf.create(OmegaConf.to_container(cfg))
    for key in ("ground", "join", "places"):
        del earlier.comm[key]
    assert config_hash(earlier) == config_hash(cfg)
    cfg.comm.ground.missing = 0.1
    assert config_hash(earlier) != config_hash(cfg)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (["comm.ground.only=true"], "comm.ground.only=true: messages learn from nothing then"),
        (
            ["comm.ground.missing=1.0"],
            "comm.ground.missing=1.0: under env.memory=shared robots in contact miss nothing",
        ),
        (
            ["comm=target", "comm.ground.sender_map=1.0"],
            "comm.ground.sender_map=1.0: nothing of the messages of comm=target is learnt",
        ),
        (["comm.ground.missing=-1.0"], "comm.ground.missing: must be a number, at least 0, not -1"),
        (["comm.ground.mising=1.0"], "comm.ground.mising: no such key; did you mean missing?"),
        (["comm.ground=1"], "comm.ground: must be a section, not 1"),
    ],
)
def test_bad_input_is_one_line(settings: list[str], why: str) -> None:
    with pytest.raises(BadInput) as caught:
        check_fit(compose_config(["comm=plan", *settings]))
    assert str(caught.value).startswith(why) and "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["comm.places=true", "comm.ground.sender_map=1.0"])
def test_a_task_without_houses_refuses_them(key: str) -> None:
    with pytest.raises(BadInput, match="^comm[a-z._]*=(true|1.0): env=pettingzoo has no"):
        check_fit(
            compose_config(["env=pettingzoo", "encoder=mlp", "comm=plan", "topology=full", key])
        )
