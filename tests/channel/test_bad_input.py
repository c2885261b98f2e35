"""Channels that cannot be are refused in one line, before a folder is made."""

from marl_clean import cli
from tests.families import family


@family(
    ("settings", "expected"),
    [
        (["channel=lossy", "channel.lossy.loss=1.5"], "channel.lossy.loss: must be a number"),
        (["channel=quantised", "channel.quantised.bits=0"], "channel.quantised.bits: must be a"),
        (["channel=[lossy,fog]"], "channel=[lossy,fog]: no such level; valid: budget, constant"),
        (["channel=[delayed,delayed]"], "channel=[delayed,delayed]: names a level twice"),
        (["channel.lossy.loss=0.5"], "lossy is not in channel=[perfect]; add it, as in channel=["),
        (
            ["channel=delayed", "channel.delayed.steps=9"],
            "trainer.window_frames: 8 frames in a row, but what is learnt goes 9 steps back",
        ),
        (["comm=dial", "trainer.window_frames=1"], "at least 2 are valid"),
        (
            ["agent=central_dqn", "comm=none", "reward=team", "channel=lossy"],
            "channel=lossy: does not fit agent=central_dqn; valid: perfect",
        ),
        (["agent=ippo"], "trainer=off_policy: does not fit agent=ippo; valid: on_policy"),
        (["trainer=on_policy"], "trainer=on_policy: does not fit agent=iql; valid: off_policy"),
        (["agent=vdn"], "reward=neighbours: does not fit agent=vdn; valid: team"),
        (
            ["agent=ippo", "trainer=on_policy", "trainer.minibatch_frames=500"],
            "trainer.minibatch_frames=500: must divide trainer.frames_per_batch=4096",
        ),
        (["encoder.memory=gru", "agent.augment=true"], "agent.augment=true: rotates single frames"),
        (
            ["agent=central_dqn", "comm=none", "reward=team", "encoder.memory=gru"],
            "encoder.memory=gru: agent=central_dqn has no memory; valid: none",
        ),
        (["evaluation.team_sizes=[2,99]"], "evaluation.team_sizes: 99: "),
    ],
)
def test_one_line_and_no_folder(tmp_path, monkeypatch, capsys, settings, expected) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", "train_houses=4", "env.num_envs=128", *settings]) == 2
    [error] = capsys.readouterr().err.splitlines()
    assert expected in error
    assert not list(tmp_path.iterdir())
