"""What needs more memory than there is, by numbers that are easily multiplied."""

import pytest

from marl_clean.commands import _memory
from marl_clean.commands._memory import check_memory, in_words, memory_bytes
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput

SMALL = ["env.num_envs=2", "env.n_agents=3", "observation.view_size=5"]
FRAME = 3 * 5**2 * 4  # bytes


@pytest.mark.parametrize(
    ("key", "most", "memory"),
    [
        ("trainer.buffer_frames", 1000, 1000 * FRAME),
        ("trainer.frames_per_batch", 600, 600 * FRAME),
    ],
)
def test_the_most_that_is_said_to_be_valid_is(
    monkeypatch: pytest.MonkeyPatch, key: str, most: int, memory: int
) -> None:
    small = [*SMALL, "trainer.buffer_frames=10", "trainer.frames_per_batch=10"]
    monkeypatch.setattr(_memory, "memory_bytes", lambda: memory)
    check_memory(compose_config([*small, f"{key}={most}"]), training=True)
    with pytest.raises(BadInput, match=rf"^{key}={most + 1}: .* valid: at most {most}$"):
        check_memory(compose_config([*small, f"{key}={most + 1}"]), training=True)


def test_a_side_counts_twice_and_a_policy_alone_sees_one_world(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_memory, "memory_bytes", lambda: 12 * 10**6)
    check_memory(compose_config([*SMALL, "observation.view_size=999"]), training=False)
    with pytest.raises(BadInput, match="view_size=1001: .* 12 MB or more, of 12 MB .* most 1000$"):
        check_memory(compose_config([*SMALL, "observation.view_size=1001"]), training=False)


def test_this_machine_has_memory_for_the_defaults_and_gpus_are_left_to_torch() -> None:
    check_memory(compose_config(), training=True)
    check_memory(compose_config(["device=cuda", "observation.view_size=999999"]), training=True)
    assert memory_bytes() > 10**9
    assert [in_words(number) for number in (1, 2500, 81_000_000_000)] == [
        "1 bytes",
        "2.5 kB",
        "81 GB",
    ]
