"""n-step windows against sums written out, above all where an episode ends inside."""

import pytest
import torch
from tensordict import TensorDict

from marl_clean import keys
from marl_clean.trainer._collecting import Windows


def block(start: int, steps: int, done_at: dict[int, str], worlds: int = 2) -> TensorDict:
    """Frames `[world, time]` with observation t and reward t + 1 at time t."""
    time = torch.arange(start, start + steps).float()
    shape = [worlds, steps, 2]
    now = time[None, :, None, None].expand(*shape, 1).clone()
    done = torch.zeros(worlds, steps, 1, dtype=torch.bool)
    terminated = done.clone()
    for at, kind in done_at.items():
        if start <= at < start + steps:
            done[:, at - start] = True
            terminated[:, at - start] = kind == "terminated"
    agents = TensorDict({"observation": now, "action": now[..., 0].long()}, shape)
    later = TensorDict({"observation": now + 1, "reward": now + 1}, shape)
    return TensorDict(
        {
            "agents": agents,
            "next": TensorDict(
                {"agents": later, "done": done, "terminated": terminated}, [worlds, steps]
            ),
        },
        [worlds, steps],
    )


@pytest.mark.parametrize("n_steps", [1, 2, 3, 5])
@pytest.mark.parametrize("sizes", [[40], [1] * 40, [3, 1, 7, 2, 9, 18]])
def test_windows_are_the_sums_they_claim(n_steps, sizes):
    gamma, done_at = 0.5, {4: "terminated", 5: "truncated", 16: "truncated", 30: "terminated"}
    windows, given, start = Windows(n_steps, gamma), [], 0
    for steps in sizes:
        ready = windows.inv(block(start, steps, done_at))
        start += steps
        if ready is not None:
            given.append(ready)
    frames = torch.cat(given, 1)
    assert frames.shape[1] == 40 - n_steps
    for t in range(frames.shape[1]):
        last = min([t + n_steps - 1, *(at for at in done_at if at >= t)])
        frame = frames[1, t]
        reward = sum(gamma ** (k - t) * (k + 1) for k in range(t, last + 1))
        assert frame["agents", "observation"].unique().item() == t
        assert frame["next", "agents", "observation"].unique().item() == last + 1
        torch.testing.assert_close(
            frame["next", keys.REWARD], torch.full((2, 1), reward, dtype=torch.float32)
        )
        assert frame[keys.STEPS_TO_NEXT_OBS].item() == last + 1 - t
        assert frame["next", "terminated"].item() == (done_at.get(last) == "terminated")
        assert frame["next", "done"].item() == (last in done_at)


def test_open_windows_go_on_in_another_transform():
    first, second = Windows(3, 0.9), Windows(3, 0.9)
    first.inv(block(0, 4, {}))
    second.restore(first.state().clone())
    windowed, whole = (
        first.inv(block(4, 4, {6: "truncated"})),
        second.inv(block(4, 4, {6: "truncated"})),
    )
    assert (windowed == whole).all()
