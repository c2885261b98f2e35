"""The probe: what a follower earns depends on a bit that the leader alone sees."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from marl_clean import keys, make_env, train
from marl_clean.errors import BadInput

PROBE = ["experiment=leader_bit", "env.n_agents=3"]
SHORT = ["trainer.total_frames=8_192", "trainer.eval_interval_frames=8_192"]


@pytest.mark.slow
def test_it_is_an_env_by_torchrls_rules() -> None:
    check_env_specs(make_env(PROBE))


@pytest.mark.slow
def test_followers_earn_by_the_bit_that_the_leader_alone_sees() -> None:
    env = make_env([*PROBE, "env.num_envs=200"])
    env.set_seed(3)
    td, draw = env.reset(), torch.Generator().manual_seed(0)
    for step in range(20):
        seen = td[keys.OBSERVATION]
        leads = seen[..., 0] == 1
        assert (leads.sum(-1) == 1).all() and (seen[~leads] == 0).all()
        bit = seen[leads][:, 2].long()
        assert torch.equal(seen[leads][:, 1], 1.0 - bit)
        td[keys.ACTION] = torch.randint(2, (200, 3), generator=draw)
        right = td[keys.ACTION] == bit[:, None]
        stepped, after = env.step_and_maybe_reset(td)
        wanted = torch.where(leads, 0.0, torch.where(right, 1.0, -1.0))
        assert torch.equal(stepped["next", keys.OWN_REWARD][..., 0], wanted)
        assert torch.equal(stepped["next", keys.REWARD][..., 0], wanted)
        ends = step % 8 == 7
        assert (stepped["next", keys.DONE] == ends).all()
        assert (stepped["next", keys.TERMINATED] == ends).all()
        assert torch.equal(after[keys.OBSERVATION], seen) is not ends
        td = after


@pytest.mark.slow
def test_leaders_and_bits_are_all_drawn_and_each_world_alone_is_the_same() -> None:
    env = make_env([*PROBE, "env.num_envs=400"])
    env.set_seed(5)
    seen = env.reset()[keys.OBSERVATION]
    pairs = torch.stack([seen[..., 0].argmax(-1), seen[..., 2].amax(-1).long()], -1)
    count = pairs.unique(dim=0, return_counts=True)[1]
    assert len(count) == 6 and count.min() > 40
    for index in (0, 7, 399):
        base = type(env.base_env)(
            3, 1, among=lambda n: torch.ones(n, n, dtype=torch.bool), first_env=index
        )
        base.set_seed(5)
        assert torch.equal(base.reset()[keys.OBSERVATION][0], seen[index])


@pytest.mark.slow
def test_a_saved_state_continues_in_the_middle_of_an_episode() -> None:
    env, other = (make_env([*PROBE, "env.num_envs=6"]).base_env for _ in range(2))
    env.set_seed(2)
    env.rollout(5, break_when_any_done=False)
    saved = env.state_dict()
    other.load_state_dict(saved)
    action = torch.ones(6, 3, dtype=torch.int64)
    for _ in range(4):
        frames = [each.step(each.rand_action().set(keys.ACTION, action)) for each in (env, other)]
        assert all(
            torch.equal(frames[0]["next", key], frames[1]["next", key])
            for key in (keys.OBSERVATION, keys.REWARD, keys.DONE)
        )
    with pytest.raises(BadInput, match=r"^env state: sizes differ"):
        make_env(PROBE).base_env.load_state_dict(saved)


def test_a_leader_needs_a_follower() -> None:
    with pytest.raises(BadInput, match=r"^env.n_agents=1: a leader needs a follower"):
        make_env(["experiment=leader_bit", "env.n_agents=1"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "solves"),
    [
        (["comm=commnet"], True),
        pytest.param(["comm=commnet", "channel=self_send"], False, marks=pytest.mark.long),
        pytest.param(["comm=commnet", "channel=constant"], False, marks=pytest.mark.long),
    ],
)
def test_messages_solve_it_and_controls_do_not(settings, solves, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    preset = "experiment=leader_bit"
    run = train([preset, *settings, *SHORT, "evaluation.houses=100", "name=probe"])
    earned = next(row["return"] for row in run.table if row["policy"] == "probe")
    most = 8 * 1  # two robots: one follower, eight steps
    assert (earned > 0.8 * most) is solves and (abs(earned) < 0.2 * most) is not solves
