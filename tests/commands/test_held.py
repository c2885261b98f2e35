"""A run that another process trains is left to it: one line, exit 2."""

import os
import time
from pathlib import Path

import pytest

from marl_clean import cli
from marl_clean.commands import comparison, train
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.storage.lock import LOCK, Held, locked
from tests.storage.test_lock import HOLD, python


@pytest.fixture
def place(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_training_a_run_twice_at_once_names_the_process_before_torch(place, capsys):
    process = python(HOLD, "runs/mine")
    try:
        assert process.stdout.readline() == "held\n"
        began = time.process_time()
        assert cli.main(["train", "name=mine"]) == cli.BAD_INPUT
        assert time.process_time() - began < 3
    finally:
        process.kill()
        process.communicate()
    error = capsys.readouterr().err
    assert error.startswith(f"marl-clean: runs/mine: held by process {process.pid} on ")
    assert error.count("\n") == 1
    assert [path.name for path in Path("runs/mine").iterdir()] == [LOCK]


@pytest.mark.slow
def test_training_holds_the_lock_and_bad_input_leaves_no_folder(place, monkeypatch):
    config = compose_config(["name=mine"])
    with locked(Path("runs/mine")), pytest.raises(Held, match=f"process {os.getpid()}"):
        train.main(config, Path("runs/mine"))

    def refused(*arguments: object) -> None:
        with pytest.raises(Held):
            train.main(config, Path("runs/mine"))
        raise BadInput("planted")

    monkeypatch.setattr(train.build, "make_env", refused)
    with pytest.raises(BadInput, match="planted"):
        train.main(config, Path("runs/mine"))
    assert list(place.iterdir()) == []


@pytest.mark.slow
def test_a_comparison_trains_the_others_and_then_names_what_is_held(place, monkeypatch):
    seen = []

    def stand_in(config, folder, console):
        with locked(folder):
            seen.append(folder)

    monkeypatch.setattr(train, "main", stand_in)
    [first, *others] = comparison.jobs_of("sharing", ["budget=smoke"]).values()
    held = Path("runs") / first[0].name
    with locked(held), pytest.raises(BadInput, match=f"figure sharing: {held}: held by process"):
        comparison.main("sharing", ["budget=smoke"])
    assert seen == [Path("runs") / config.name for [config] in others]
