"""What is kept of Hydra's compositions is what Hydra would compose."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from marl_clean.config import hydra_adapter
from marl_clean.config.locate import own
from marl_clean.config.overrides import parse_overrides

SETTINGS = [
    "experiment=any_house",
    "seed=7",
    "channel=[lossy,delayed]",
    "channel.lossy.loss=0.2",
    "evaluation.sides=[8,9]",
    "env.max_steps=null",
    "name='a b'",
]


@pytest.mark.slow
def test_values_are_set_as_hydra_sets_them() -> None:
    parsed = parse_overrides(SETTINGS)
    wanted = hydra_adapter._by_hydra(SETTINGS)
    assert wanted.channel.lossy.loss == 0.2
    for _ in range(2):  # the second time in a copy of what was kept
        composed = hydra_adapter.compose(parsed)
        assert composed == wanted
        composed.seed = 8


def test_a_file_that_has_changed_is_read_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = replace(own(), conf=tmp_path / "conf")
    shutil.copytree(own().conf, ours.conf)
    monkeypatch.setattr(hydra_adapter, "own", lambda: ours)
    monkeypatch.setattr(hydra_adapter, "packages", lambda: (ours,))
    assert hydra_adapter.compose([]).seed == 0
    path = ours.conf / "config.yaml"
    path.write_text(path.read_text().replace("\nseed: 0", "\nseed: 12"))
    assert hydra_adapter.compose([]).seed == 12
