"""A training that is killed again and again ends with the same files, bit for bit."""

import pytest
import torch

from marl_clean.storage import checkpoint, files
from marl_clean.trainer import base
from tests.reliability import kills
from tests.reliability.forks import Broken
from tests.reliability.kills import Training, fire

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]


@pytest.fixture(scope="module")
def trainings(tmp_path_factory: pytest.TempPathFactory) -> list[Training]:
    torch.set_num_threads(1)
    place = tmp_path_factory.mktemp("killed")
    return [Training(kind, place) for kind in ("iql", "delayed")]


def test_kills_at_any_moment_lose_nothing(trainings: list[Training]) -> None:
    seen = fire(trainings, 16)
    assert seen.kills.total() == 16
    assert seen.in_saves >= 4


def test_a_random_state_that_is_not_restored_is_seen(
    trainings: list[Training], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base, "restore_random", lambda states, device: None)
    with pytest.raises(Broken, match="is not that of the whole run"):
        fire(trainings[:1], 10)


def test_writes_in_place_that_nothing_verifies_are_seen(
    trainings: list[Training], monkeypatch: pytest.MonkeyPatch
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
        fire(trainings[:1], 40)
