"""Reward shaping: it telescopes, only the payment includes it, with the learner's discount."""

import pytest
import torch

from marl_clean import build, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.env.shaping import Shaping
from marl_clean.evaluation.evaluator import held_out_env
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer.off_policy import OffPolicyLoop
from marl_clean.world.potential import FARTHEST, by_machine_code, by_tensors, potential
from tests.world.play import houses_of

WEIGHT, GAMMA = 0.5, 0.9
SMALL = [
    "train_houses=8",
    "house=open",
    "house.rows=[2,5]",
    "house.cols=[2,5]",
    "env.num_envs=9",
    "env.n_agents=2",
    "env.stuck_after=9",
    f"agent.gamma={GAMMA}",
]
SHAPED = [*SMALL, f"env.shaping={WEIGHT}"]


def played(settings: list[str], steps: int = 150):
    env = build.make_env(compose_config(settings))
    frame, frames = env.reset(), []
    generator = torch.Generator().manual_seed(1)
    for _ in range(steps):
        frame[keys.ACTION] = torch.randint(4, (9, 2), generator=generator)
        stepped, frame = env.step_and_maybe_reset(frame)
        frames.append(stepped.clone())
    return torch.stack(frames, 1)


@pytest.mark.slow
@pytest.mark.parametrize("memory", ["shared", "private", "merged"])
def test_the_discounted_sum_of_an_episode_depends_on_its_ends_alone(memory: str) -> None:
    """sum of gamma^t w (gamma phi' - phi) = w (gamma^T phi_T - phi_0), phi_T 0 if terminated."""
    steps = played([*SHAPED, f"env.memory={memory}"])
    later = steps["next"]
    endings = {keys.TERMINATED: 0, keys.TRUNCATED: 0}
    for world in range(9):
        begin = 0
        for end in later[keys.DONE][world, :, 0].nonzero()[:, 0].tolist():
            episode, after = steps[world, begin : end + 1], later[world, begin : end + 1]
            length = end + 1 - begin
            discount = GAMMA ** torch.arange(length, dtype=torch.float64)
            term = after[keys.INFO_SHAPING].double()
            total = (discount[:, None, None] * term).sum(0)
            for ending in endings:
                endings[ending] += int(after[ending][-1])
            last = after[keys.POTENTIAL][-1].double() * ~after[keys.TERMINATED][-1]
            wanted = WEIGHT * (GAMMA**length * last - episode[keys.POTENTIAL][0].double())
            torch.testing.assert_close(total, wanted, atol=1e-4, rtol=0)
            begin = end + 1
    assert min(endings.values()) > 5, endings


@pytest.mark.slow
def test_only_the_payment_includes_it() -> None:
    shaped, plain = played(SHAPED, steps=60), played(SMALL, steps=60)
    assert keys.INFO_SHAPING not in plain["next"].keys(True, True)
    assert torch.equal(shaped["next", keys.OWN_REWARD], plain["next", keys.OWN_REWARD])
    assert plain["next", keys.DONE].any()
    assert torch.equal(shaped["next", keys.DONE], plain["next", keys.DONE])
    adjacency = plain[keys.ADJACENCY]
    earned = plain["next", keys.OWN_REWARD] + shaped["next", keys.INFO_SHAPING]
    paid = earned + (adjacency * earned.mT).sum(-1, keepdim=True)  # reward=neighbours
    torch.testing.assert_close(shaped["next", keys.REWARD], paid)
    assert (shaped["next", keys.INFO_SHAPING] != 0).any()


@pytest.mark.parametrize(
    ("free", "known", "expected"),
    [
        ([1, 1, 1, 1], [1.0, 0.5, 0.5, 0.5], -1),  # touched, not cleaned
        ([1, 1, 1, 1], [1.0, 1.0, 1.0, 0.0], -3),  # unknown
        ([1, 1, 1, 1], [1.0, 1.0, 1.0, 1.0], -60),  # nothing left; the ring does not count
        ([1, 1, 0, 1], [1.0, 1.0, -1.0, 0.0], -60),  # out of reach
        ([1] * 70, [1.0] * 69 + [0.0], -60),  # farther than the farthest
    ],
)
def test_the_potential_of_a_lane(free: list[int], known: list[float], expected: int) -> None:
    lane = houses_of([[bool(cell) for cell in free]], None, [(0, 0)])
    cfg = compose_config([*SHAPED, "env.n_agents=1", "env.num_envs=1"])
    env = build.make_env(cfg, lane)
    env.reset()
    margin = env.base_env.rules.margin
    env.base_env.state.record[0, 0, margin, margin : margin + len(known)] = torch.tensor(known)
    assert potential(env.base_env.state, env.base_env.rules).tolist() == [[[expected]]]


@pytest.mark.slow
@pytest.mark.parametrize("memory", ["shared", "private"])
def test_machine_code_and_tensors_search_alike(memory: str) -> None:
    env = build.make_env(compose_config([*SHAPED, "env.stuck_after=40", f"env.memory={memory}"]))
    frame, seen = env.reset(), set()
    for _ in range(60):
        frame = env.rand_step(frame)["next"].exclude("reward")
        state, rules = env.base_env.state, env.base_env.rules
        steps = by_machine_code(state, rules).clamp(max=FARTHEST)
        assert torch.equal(steps, by_tensors(state, rules).clamp(max=FARTHEST))
        seen |= {*steps.flatten().tolist()}
    assert len(seen) > 3


@pytest.mark.slow
def test_evaluation_does_not_compute_it() -> None:
    cfg = compose_config(SHAPED)
    env = held_out_env(cfg, build.held_out_houses(cfg, "validation", 3), "validation", 3)
    assert keys.POTENTIAL not in env.observation_spec.keys(True, True)
    assert not any(isinstance(transform, Shaping) for transform in env.transforms)


@pytest.mark.slow
def test_a_training_shapes_by_the_learners_present_discount(tmp_path) -> None:
    settings = ["trainer.frames_per_batch=18", "trainer.batch_frames=18", "encoder.hidden=[16]"]
    rising = ["agent.gamma_end=0.99", "trainer.total_frames=180"]
    cfg = compose_config([*SHAPED, *settings, *rising])
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    shaping = next(t for t in env.transforms if isinstance(t, Shaping))
    assert shaping.gamma == GAMMA
    loop = OffPolicyLoop(
        instantiate(cfg.trainer), env, agent, lambda policy: {}, [], Checkpoints(tmp_path)
    )
    loop.collect()
    gamma = shaping.gamma
    assert gamma == agent.gamma > GAMMA
    later = loop.collect()
    term = WEIGHT * (
        gamma * later["next", keys.POTENTIAL] * ~later["next", keys.TERMINATED][..., None]
        - later[keys.POTENTIAL]
    )
    torch.testing.assert_close(later["next", keys.INFO_SHAPING], term)
    assert "shaping" in loop.tally.means()
    loop.close()
