"""NaN and infinity are found wherever a tree holds them, and by their paths."""

import pytest
import torch
from tensordict import TensorDict

from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.storage.finite import Diverged, not_finite

BAD = [torch.nan, torch.inf, -torch.inf]


def tree(bad: float) -> dict:
    half = torch.zeros(3, dtype=torch.bfloat16)
    frames = TensorDict({"agents": {"reward": torch.tensor([[0.0], [bad]])}}, [2])
    return {
        "counter": 3,
        "name": "nan",
        "none": None,
        "empty": torch.zeros(0),
        "flags": torch.ones(2, dtype=torch.bool),
        "large": torch.full((2, 3), 3e38),
        "lr": bad,
        "moments": [{0: {"exp_avg": torch.tensor(bad, dtype=torch.float64)}}, (half, half + bad)],
        "replay": frames,
        "strided": torch.tensor([[0.0, 0.0], [bad, 0.0]], requires_grad=True).mT,
    }


@pytest.mark.parametrize("bad", BAD)
def test_what_is_not_finite_is_named_in_the_order_of_the_tree(bad: float) -> None:
    assert not_finite(tree(0.5)) == []
    assert not_finite(tree(bad)) == [
        "lr",
        "moments/0/0/exp_avg",
        "moments/1/1",
        "replay/agents/reward",
        "strided",
    ]


@pytest.mark.parametrize("bad", BAD)
def test_nothing_that_is_not_finite_is_saved(tmp_path, bad: float) -> None:
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    for saved, notes in (({"a": torch.tensor(bad)}, {}), ({"a": bad}, {}), ({}, {"a": bad})):
        with pytest.raises(Diverged, match=r"^frame 64: a is NaN or infinite; state is not saved$"):
            checkpoints.save("state", 64, saved, notes)
    assert not checkpoints.folder.exists()
