"""Checkpoints: what is saved comes back, and damage never does."""

import errno
import json
import os
import random
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from tensordict import TensorDict
from torch import nn

from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage.checkpoint import FOLDER, Checkpoints, fit_weights, load_weights
from tests.reliability.damage import damage

TREE = {
    "weights": {"a.0": torch.randn(3, 2), "b": torch.randn(2, 3, 4, 5)},
    "flags": torch.tensor([True, False]),
    "half": torch.randn(3).bfloat16(),
    "empty": torch.zeros(2, 0),
    "count": torch.tensor(7),
    "adam": {0: {"step": torch.tensor(3.0)}, "groups": [{"betas": (0.9, 0.999), "lr": 1e-3}]},
    "nothing": None,
    "carried": TensorDict({"agents": TensorDict({"x": torch.ones(2, 3, 1)}, [2, 3])}, [2]),
}


def assert_equal(mine, theirs):
    assert type(mine) is type(theirs)
    if isinstance(mine, torch.Tensor):
        assert mine.dtype == theirs.dtype
        assert mine.stride() == theirs.stride()
        assert torch.equal(mine, theirs)
    elif isinstance(mine, TensorDict):
        assert mine.batch_size == theirs.batch_size
        assert_equal(dict(mine.items()), dict(theirs.items()))
    elif isinstance(mine, dict):
        assert list(mine) == list(theirs)
        for key, value in mine.items():
            assert_equal(value, theirs[key])
    elif isinstance(mine, list | tuple):
        for value, other in zip(mine, theirs, strict=True):
            assert_equal(value, other)
    else:
        assert mine == theirs


def saved(tmp_path: Path, *frames: int, kind: str = "state") -> Checkpoints:
    checkpoints = Checkpoints(tmp_path / FOLDER)
    for count in frames:
        checkpoints.save(kind, count, {"x": torch.full((1000,), float(count))}, {})
    return checkpoints


def test_a_tree_comes_back_as_it_was(tmp_path):
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save("state", 12, TREE, {"T_100": 91.5})
    loaded = checkpoints.newest("state")
    assert (loaded.frames, loaded.notes) == (12, {"T_100": 91.5})
    assert_equal(loaded.tree, TREE)


def test_memory_format_comes_back(tmp_path):
    weight = torch.randn(4, 3, 3, 3).to(memory_format=torch.channels_last)
    Checkpoints(tmp_path).save("state", 0, [weight], {})
    (back,) = Checkpoints(tmp_path).newest("state").tree
    assert back.stride() == weight.stride()
    assert torch.equal(back, weight)


def test_the_tensors_are_a_plain_safetensors_file(tmp_path):
    tree = {"encoder.weight": torch.randn(3, 5), "half": torch.randn(2).bfloat16()}
    Checkpoints(tmp_path).save("best", 1, tree, {})
    loaded = load_file(tmp_path / "best-000000000001" / "tensors.safetensors")
    assert_equal(dict(sorted(loaded.items())), dict(sorted(tree.items())))


def test_older_ones_are_pruned_kind_by_kind(tmp_path):
    saved(tmp_path, 1, kind="best")
    checkpoints = saved(tmp_path, 1, 2, 3)
    names = sorted(path.name for path in checkpoints.folder.iterdir())
    assert names == ["best-000000000001", "state-000000000002", "state-000000000003"]


def test_a_run_that_goes_back_forgets_what_came_after(tmp_path):
    checkpoints = saved(tmp_path, 1, 2)
    checkpoints.forget_after(1)
    assert checkpoints.newest("state").frames == 1


def test_without_any_there_is_none(tmp_path):
    assert Checkpoints(tmp_path / "absent").newest("state") is None


@pytest.mark.parametrize(("kind", "trials"), [("truncate", 100), ("flip", 100), ("delete", 20)])
def test_damage_is_seen_and_the_one_before_is_taken(tmp_path, caplog, kind, trials):
    checkpoints = saved(tmp_path, 1, 2)
    newest = checkpoints.folder / "state-000000000002"
    whole = tmp_path / "whole"
    shutil.copytree(newest, whole)
    draw = random.Random(0)
    for _ in range(trials):
        damage(newest, kind, draw)
        caplog.clear()
        assert checkpoints.newest("state").frames == 1
        assert len(caplog.records) == 1
        assert "\n" not in caplog.messages[0]
        shutil.rmtree(newest)
        shutil.copytree(whole, newest)
    assert checkpoints.newest("state").frames == 2


def test_all_damaged_is_said_in_one_line(tmp_path):
    checkpoints = saved(tmp_path, 1)
    (checkpoints.folder / "state-000000000001" / "manifest.json").unlink()
    with pytest.raises(BadInput, match="every state checkpoint is damaged"):
        checkpoints.newest("state")


def test_saving_the_same_frames_again_mends_a_damaged_one(tmp_path):
    checkpoints = saved(tmp_path, 1)
    (checkpoints.folder / "state-000000000001" / "state.json").write_text("{}")
    saved(tmp_path, 1)
    saved(tmp_path, 1)
    assert checkpoints.newest("state").frames == 1


CALLS = ["mkdir", "fsync", "rename", "rmdir", "unlink"]


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("call", CALLS)
def test_a_crash_at_any_call_leaves_the_old_or_the_new(tmp_path, monkeypatch, call, after):
    """Stop at the k-th use of each filesystem call of a save that also prunes, for every k."""

    class Crash(BaseException):
        pass

    for k in range(100):
        run = tmp_path / f"{call}-{k}"
        checkpoints = saved(run, 1, 2)
        real, used = getattr(os, call), 0

        def crashing(*args, k=k, real=real, **kwargs):
            nonlocal used
            used += 1
            if used == k + 1 and not after:
                raise Crash
            result = real(*args, **kwargs)
            if used == k + 1:
                raise Crash
            return result

        with monkeypatch.context() as patch:
            patch.setattr(os, call, crashing)
            try:
                saved(run, 3)
            except Crash:
                crashed = True
            else:
                crashed = False
        assert checkpoints.newest("state").frames in (2, 3)
        saved(run, 4)
        assert checkpoints.newest("state").frames == 4
        if not crashed:
            break
    else:
        raise AssertionError("never ran to its end")


def test_a_full_disk_leaves_the_old_one_and_no_leftovers(tmp_path, monkeypatch):
    checkpoints = saved(tmp_path, 1)

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(BadInput, match="No space left"):
            saved(tmp_path, 2)
    assert [path.name for path in checkpoints.folder.iterdir()] == ["state-000000000001"]
    saved(tmp_path, 2)
    assert checkpoints.newest("state").frames == 2


def test_leftovers_of_a_kill_are_cleared_by_the_next_save(tmp_path):
    checkpoints = saved(tmp_path, 1)
    (checkpoints.folder / ".partial-state-000000000002").mkdir()
    (checkpoints.folder / ".partial-state-000000000002" / "x").write_bytes(b"half")
    saved(tmp_path, 3)
    assert not [path for path in checkpoints.folder.iterdir() if path.name.startswith(".")]


def reseal(folder: Path) -> None:
    """Make the manifest hold again, as a stranger can."""
    described = {
        name: vars(files.digest_of(folder / name)) for name in ("tensors.safetensors", "state.json")
    }
    (folder / "manifest.json").write_text(json.dumps({"schema": 1, "files": described}))


HOSTILE = [
    "",
    "[]",
    "{}",
    "null",
    "[" * 5000,
    '{"a":' * 5000,
    '{"frames":1,"notes":{}}',
    '{"frames":"x","notes":{},"tree":null}',
    '{"frames":1,"notes":3,"tree":null}',
    '{"frames":1,"notes":{},"tree":{"tensor":"absent","channels_last":false}}',
    '{"frames":1,"notes":{},"tree":{"tensor":"x","channels_last":true}}',
    '{"frames":1,"notes":{},"tree":{"pickle":"gASV"}}',
    '{"frames":1,"notes":{},"tree":{"dict":[[1]]}}',
    '{"frames":1,"notes":{},"tree":{"dict":[[[],1]]}}',
    '{"frames":1,"notes":{},"tree":{"tensordict":[["x",1]],"batch_size":["a"]}}',
]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_a_strangers_state_is_refused_even_with_a_manifest_that_holds(tmp_path, text):
    checkpoints = saved(tmp_path, 1)
    folder = checkpoints.folder / "state-000000000001"
    (folder / "state.json").write_text(text)
    reseal(folder)
    with pytest.raises(BadInput):
        checkpoints.newest("state")


@pytest.mark.parametrize(
    "content",
    [b"", b"\x80\x04K*.", b"\xff" * 8, b"\x02" + b"\0" * 7 + b"[]", b"PK\x03\x04" * 10],
    ids=["empty", "pickle", "length", "list", "zip"],
)
def test_strange_tensors_are_refused(tmp_path, content):
    checkpoints = saved(tmp_path, 1)
    folder = checkpoints.folder / "state-000000000001"
    (folder / "tensors.safetensors").write_bytes(content)
    reseal(folder)
    with pytest.raises(BadInput):
        checkpoints.newest("state")


def test_links_are_not_followed(tmp_path):
    checkpoints = saved(tmp_path, 1)
    file = checkpoints.folder / "state-000000000001" / "state.json"
    moved = tmp_path / "elsewhere.json"
    file.rename(moved)
    file.symlink_to(moved)
    with pytest.raises(BadInput):
        checkpoints.newest("state")


def network() -> nn.Module:
    return nn.Sequential(nn.Linear(3, 4), nn.Linear(4, 2))


def test_weights_are_the_best_else_the_final_ones(tmp_path):
    with pytest.raises(BadInput, match="has no weights yet"):
        load_weights(tmp_path)
    first, second = network(), network()
    checkpoints = Checkpoints(tmp_path / FOLDER)
    checkpoints.save("final", 9, first.state_dict(), {})
    fit_weights(second, load_weights(tmp_path).tree, tmp_path)
    assert torch.equal(first[0].weight, second[0].weight)
    checkpoints.save("best", 5, network().state_dict(), {})
    assert load_weights(tmp_path).frames == 5


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda w: w.pop("0.bias"), "another network"),
        (lambda w: w.update(extra=torch.ones(1)), "another network"),
        (lambda w: w.update({"0.bias": torch.ones(3)}), r"0\.bias is \[3\]"),
        (lambda w: w.update({"0.bias": torch.ones(4).double()}), "0.bias is no torch.float32"),
        (lambda w: w.update({"0.bias": torch.full((4,), torch.nan)}), "NaN"),
        (lambda w: w.update({"0.bias": "text"}), "0.bias is no"),
    ],
)
def test_weights_that_do_not_fit_are_bad_input_and_change_nothing(change, reason):
    weights, target = dict(network().state_dict()), network()
    before = {name: value.clone() for name, value in target.state_dict().items()}
    change(weights)
    with pytest.raises(BadInput, match=reason):
        fit_weights(target, weights, Path("run"))
    assert all(torch.equal(before[name], value) for name, value in target.state_dict().items())


def test_what_cannot_be_saved_is_an_error_at_once(tmp_path):
    with pytest.raises(TypeError, match="/deep/0: a set"):
        Checkpoints(tmp_path).save("state", 0, {"deep": [{1, 2}]}, {})
