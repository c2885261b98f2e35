"""A run's first updates are noted, and repeated: the same weights, or what differs in lines."""

import io
from pathlib import Path

import pytest
import torch
from rich.console import Console

from marl_clean import cli
from marl_clean.commands import made_with, train, verify
from marl_clean.commands.run_record import RECORD
from marl_clean.errors import BadInput
from marl_clean.trainer._first_updates import BLOCKS, FILE, FirstUpdates, digest_of, read
from tests.families import family

TINY = (
    "train name=run trainer.total_frames=512 trainer.frames_per_batch=64 evaluation.houses=2"
    " trainer.eval_interval_frames=512 trainer.log_interval_frames=128 evaluation.plans=[]"
    " train_houses=8 env.num_envs=8 env.max_steps=20 logger=[csv]"
).split()
LEARNERS = {
    "iql": ["+experiment=quick", "trainer.start_frames=64"],
    "ippo": ["+experiment=any_house", "trainer.minibatch_frames=32", "evaluation.sides=[]"],
}
FOLDER = Path("runs/run")


def said() -> tuple[int, str]:
    out = io.StringIO()
    return verify.main("run", Console(file=out, width=300)), out.getvalue()


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked", "one_thread")
@family("learner", LEARNERS, fast=[], usual=1)
def test_a_run_is_repeated(learner: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(train, "draw", lambda config, folder: None)
    assert cli.main([*TINY, *LEARNERS[learner]]) == 0
    noted = read(FOLDER / FILE)
    updates = [each.updates for each in noted]
    assert len(updates) == BLOCKS and updates == sorted(set(updates))
    files = {path: path.read_bytes() for path in FOLDER.rglob("*") if path.is_file()}
    code, line = said()
    last = noted[-1]
    assert code == 0 and line == (
        f"run: weights after {last.updates} updates from {last.frames} frames are the same,"
        " bit for bit\n"
    )
    assert {path: path.read_bytes() for path in FOLDER.rglob("*") if path.is_file()} == files

    config = FOLDER / "config.yaml"
    config.write_text(config.read_text().replace("seed: 0", "seed: 1", 1))
    code, line = said()
    assert code == 1 and f"weights differ after update {noted[0].updates}" in line
    assert "code, versions and hardware are the same" in line
    monkeypatch.setattr(made_with, "versions", lambda: {"torch": "9.9"})
    assert ": 2" in (changed := said()[1]) and "torch: " in changed and "then, 9.9 now" in changed
    (FOLDER / RECORD).unlink()
    assert f"no {RECORD} says" in said()[1]


def test_what_was_never_noted_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(["verify", "nothing"]) == 2
    FOLDER.mkdir(parents=True)
    (FOLDER / "config.yaml").write_text("seed: 0")
    capsys.readouterr()
    assert cli.main(["verify", "run"]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert f"has no {FILE}: its first updates were never noted" in line


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("{", "holds no first updates"),
        ("[]", "holds no first updates"),
        (
            '{"version": 1, "updated": [{"frames": 1, "updates": 1, "sha256": "x"}]}',
            "holds no first",
        ),
        ('{"version": 2, "updated": []}', "is of version 2; valid: 1"),
        ('{"version": 1, "updated": [' + " " * 10_000 + "]}", "is larger than 10000 bytes"),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path: Path, content: str, fault: str) -> None:
    path = tmp_path / FILE
    path.write_text(content)
    with pytest.raises(BadInput, match=fault) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_resumed_run_keeps_what_it_noted_until_then(tmp_path: Path) -> None:
    network = torch.nn.Linear(2, 2)
    first = FirstUpdates(tmp_path)
    for block in range(1, BLOCKS + 3):
        first.note(64 * block, max(0, block - 1), network)  # nothing is learnt in the first block
        torch.nn.init.constant_(network.weight, float(block))
    noted = read(tmp_path / FILE)
    assert [each.updates for each in noted] == [1, 2, 3]
    assert len({each.sha256 for each in noted}) == 3
    resumed = FirstUpdates(tmp_path)
    resumed.resume(128, 1)
    assert resumed.updated == noted[:1]
    for damage in (lambda: (tmp_path / FILE).write_text("{"), (tmp_path / FILE).unlink):
        damage()
        late = FirstUpdates(tmp_path)
        late.resume(128, 1)
        late.note(192, 2, network)
        assert late.updated == []  # the third block is not its first
    anew = FirstUpdates(tmp_path)
    anew.resume(64, 0)  # nothing had been learnt
    anew.note(128, 1, network)
    assert [each.frames for each in anew.updated] == [128]


def test_a_digest_is_of_names_shapes_and_bits() -> None:
    weight = torch.arange(6.0)
    digests = {
        digest_of(weights)
        for weights in (
            {"a": weight},
            {"b": weight},
            {"a": weight.view(2, 3)},
            {"a": weight.double()},
            {"a": torch.nextafter(weight, torch.tensor(9.0))},
            {"a": weight, "b": weight},
        )
    }
    assert len(digests) == 6
    assert digest_of({"b": weight, "a": weight}) == digest_of({"a": weight, "b": weight})
    assert digest_of({"a": weight.view(2, 3).T.contiguous().T}) == digest_of(
        {"a": weight.view(2, 3)}
    )
