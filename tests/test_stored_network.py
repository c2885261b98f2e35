"""A stranger's config asks for no more memory than the weights that came with it."""

import os
import shutil
from pathlib import Path

import pytest
import torch
import yaml

from marl_clean import build
from marl_clean.config.stored import shipped_runs
from marl_clean.errors import BadInput
from marl_clean.storage.manifest import count_weights

pytestmark = pytest.mark.usefixtures("unchecked")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(shipped_runs()["approach_2_frontier"], tmp_path / "theirs"))


def change(run: Path, room: str, **keys: object) -> None:
    path = run / "config.yaml"
    plain = yaml.safe_load(path.read_text())
    section = plain[room] if room else plain
    section.update(keys)
    path.write_text(yaml.safe_dump(plain))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("room", "keys"),
    [
        ("encoder", {"hidden": [16_384] * 32}),
        ("encoder", {"channels": [4_096] * 3}),
        ("comm", {"message_dim": 16_384}),
    ],
)
def test_a_network_far_larger_than_its_weights_is_not_built(
    room: str, keys: dict[str, object], run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change(run, room, **keys)
    monkeypatch.setattr(build, "make_agent", lambda *given: pytest.fail("built"))
    state = torch.get_rng_state()
    with pytest.raises(BadInput, match=r"its config needs [\d,]+ weights or more, its checkpoint"):
        build.load_policy(run)
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.slow
def test_weights_far_larger_than_the_network_are_not_read(run: Path) -> None:
    [checkpoint] = (run / "checkpoints").iterdir()
    os.truncate(checkpoint / "tensors.safetensors", 1 << 40)  # takes no room on the disk
    assert count_weights(run) is None
    with pytest.raises(BadInput, match="every best checkpoint is damaged"):
        build.load_policy(run)


@pytest.mark.slow
def test_a_budget_counts_as_one_feature(run: Path) -> None:
    change(run, "", parameter_budget=count_weights(run))
    build.load_policy(run)


def test_the_weights_of_a_hostile_header_are_not_counted(run: Path) -> None:
    [checkpoint] = (run / "checkpoints").iterdir()
    header = (50_000).to_bytes(8, "little") + b"[" * 50_000
    (checkpoint / "tensors.safetensors").write_bytes(header)
    assert count_weights(run) is None
