"""A training that is killed again and again ends with the same files, bit for bit."""

import pytest
import torch

from marl_clean.storage import checkpoint, files
from marl_clean.trainer import base
from tests.reliability import kills
from tests.reliability.forks import Broken
from tests.reliability.kills import Training, fire

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked", "one_thread")]


@pytest.fixture(scope="module")
def delayed(tmp_path_factory: pytest.TempPathFactory) -> Training:
    torch.set_num_threads(1)
    return Training("delayed", tmp_path_factory.mktemp("killed"))


@pytest.mark.long
def test_kills_at_any_moment_lose_nothing(iql: Training, delayed: Training) -> None:
    seen = fire([iql, delayed], 12)
    assert seen.kills.total() == 12
    # Where a kill meets a training hangs on the machine; a quarter is to be inside a save.
    for _ in range(20):
        if 4 * seen.in_saves >= seen.kills.total():
            return
        so_far = seen.kills.total()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(kills, "AT_SAVES", 1.0)
            fire([iql, delayed], so_far + 1, seed=so_far, seen=seen)
    raise AssertionError(f"too few inside a save: {seen}")


@pytest.mark.long
def test_a_random_state_that_is_not_restored_is_seen(
    iql: Training, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "restore_random", lambda states, device: None)
    with pytest.raises(Broken, match="is not that of the whole run"):
        fire([iql], 10)


@pytest.mark.long
def test_writes_in_place_that_nothing_verifies_are_seen(
    iql: Training, monkeypatch: pytest.MonkeyPatch
) -> None:
    def in_place(path, contents, summary, summarise):
        path.mkdir(exist_ok=True)
        for name, content in contents.items():
            (path / name).write_bytes(b"".join(map(bytes, content)))
        digests = {name: files.digest_of(path / name) for name in contents}
        (path / summary).write_bytes(summarise(digests))

    monkeypatch.setattr(files, "write_folder", in_place)
    monkeypatch.setattr(checkpoint, "verify", lambda path: {})
    monkeypatch.setattr(kills, "AT_SAVES", 1.0)
    with pytest.raises(Broken, match="is unreadable"):
        fire([iql], 40)
