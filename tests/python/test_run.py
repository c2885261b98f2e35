"""A trained run in Python: the same as the commands make and measure."""

import builtins
import csv
import json
from pathlib import Path
from typing import Any

import pytest
import torch
from matplotlib.figure import Figure

import marl_clean
from marl_clean import BadInput, Run, cli, keys
from marl_clean.commands import train as train_command
from marl_clean.config.stored import RUNS, load_config
from tests.python.conftest import SMALL

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("unchecked")]  # a run is trained


def test_training_leaves_what_the_command_leaves(run: Run) -> None:
    assert run.folder == RUNS / "mine"
    assert {path.name for path in run.folder.iterdir()} >= {
        "config.yaml", "metrics.csv", "checkpoints", "evaluation.json", "curve.png", "replay.gif",
        "replay.json",
    }  # fmt: skip
    assert run.config == load_config(run.folder) and run.config.env.num_envs == 8


def test_the_same_call_again_returns_the_finished_run(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_command, "measure_all", None)  # not measured again
    again = marl_clean.train(
        ["encoder.memory=gru", "comm=commnet", "channel=[lossy,delayed]"],
        burst_start=0.3, steps=2, name="mine", **SMALL,
    )  # fmt: skip
    assert again.folder == run.folder and again.table.rows == run.table.rows


def test_an_interrupt_is_pythons_own(workplace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*arguments: Any) -> Any:
        raise SystemExit(130)

    monkeypatch.setattr(train_command, "main", stopped)
    with pytest.raises(KeyboardInterrupt):
        marl_clean.train(name="stopped", **SMALL)


def test_the_table_is_evaluation_json_as_rows(run: Run) -> None:
    stored = json.loads((run.folder / "evaluation.json").read_text())
    table = run.table
    assert table.entries == stored and len(table) == len(stored)
    first = table[0]
    assert first["policy"] == "mine" and first["T_100"] == stored[0]["summary"]["T_100"]["mean"]
    assert [first["T_90_low"], first["T_90_high"]] == stored[0]["summary"]["T_90"]["ci95"]
    assert [row["policy"] for row in table][1] == table[1:][0]["policy"] == "random"
    assert len(table.houses) == 3 * len(stored)
    assert table.houses[0] == {"policy": "mine", "house_set": "test", **stored[0]["houses"][0]}
    frame = table.to_pandas()
    assert list(frame["policy"]) == [row["policy"] for row in table]
    assert "nearest_unknown" in str(table) and "T_100" in str(table)


def test_without_pandas_the_message_names_what_to_install(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == "pandas":
            raise ModuleNotFoundError(name="pandas")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(BadInput, match="pip install pandas"):
        run.table.to_pandas()


@pytest.mark.long
@pytest.mark.parametrize(
    ("keywords", "settings"),
    [
        ({}, []),
        (
            {"house": "apartment", "houses": 2, "max_steps": 9},
            ["house=floorplan", "house.path=apartment", "evaluation.houses=2", "env.max_steps=9"],
        ),
        ({"intervention": ["zero", "shut"], "max_steps": 9}, ["env.max_steps=9"]),
    ],
)
def test_it_measures_what_the_command_measures(
    run: Run, keywords: dict[str, Any], settings: list[str]
) -> None:
    changed = ["intervention=zero,shut"] if "intervention" in keywords else []
    arguments = ["checkpoint=mine", "out=told.json", *settings, *changed]
    assert cli.main(["evaluate", *arguments]) == 0
    wanted = json.loads(Path("told.json").read_text())
    for table in (run.evaluate(**keywords), marl_clean.evaluate("mine", **keywords)):
        assert json.loads(json.dumps(table.entries)) == wanted


@pytest.mark.long
def test_a_file_is_written_only_with_out(workplace: Path) -> None:
    before = {*workplace.rglob("*")}
    table = marl_clean.evaluate(["planner=random"], houses=2)
    assert {*workplace.rglob("*")} == before
    marl_clean.evaluate(planner="random", houses=2, out="written.json")
    assert json.loads(Path("written.json").read_text()) == table.entries


@pytest.mark.long
def test_comparing_returns_what_the_command_writes(run: Run) -> None:
    assert cli.main(["compare", "mine", "--against", "nearest_unknown", "--out", "c.json"]) == 0
    table = marl_clean.compare(run, against="nearest_unknown")
    assert table.entries == json.loads(Path("c.json").read_text())
    assert json.loads(json.dumps(table.differences)) == json.loads(
        Path("c_paired.json").read_text()
    )


def test_the_policy_and_the_env_go_together(run: Run) -> None:
    env = run.env(num_envs=3, n_agents=2)
    played = env.rollout(4, run.policy, break_when_any_done=False)
    assert played[keys.ACTION].shape == (3, 4, 2)
    alike = marl_clean.load_policy("mine")
    for mine, other in zip(run.policy.parameters(), alike.parameters(), strict=True):
        assert torch.equal(mine, other)


def test_the_curve_has_a_line_for_what_was_logged(run: Run) -> None:
    figure = run.curve()
    assert isinstance(figure, Figure)
    with (run.folder / "metrics.csv").open() as file:
        names = {name.rpartition("/")[2] for name in next(csv.reader(file))}
    assert {axes.get_title(loc="left") for axes in figure.axes if axes.lines} <= names


def test_a_replay_is_the_runs_own_or_that_of_the_settings(run: Run) -> None:
    own = run.replay()
    assert own == run.folder / "replay.gif"
    before = own.read_bytes()
    other = run.replay(max_steps=3)
    assert other.parent == RUNS / "figures" and other.read_bytes()[:3] == b"GIF"
    chosen = run.replay("here.gif", max_steps=3)
    assert chosen == Path("here.gif") and chosen.read_bytes() == other.read_bytes()
    assert own.read_bytes() == before


def test_a_run_trained_on_a_gpu_acts_here(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    config = run.folder / "config.yaml"
    text = config.read_text()
    config.write_text(text.replace("device: cpu", "device: cuda:7"))
    try:
        with pytest.raises(BadInput, match="device=cuda:7: not on this machine; valid: cpu"):
            Run("mine")
        here = Run("mine", device="cpu")
        assert here.env(num_envs=2).rollout(2, here.policy).device == torch.device("cpu")
        assert marl_clean.load_policy("mine")
    finally:
        config.write_text(text)


def test_a_missing_file_of_a_run_is_one_line(workplace: Path) -> None:
    shipped = Run("approach_2_frontier")
    with pytest.raises(BadInput, match="has no evaluation.json; train it to its end"):
        print(shipped.table)
    with pytest.raises(BadInput, match="has no metrics.csv"):
        shipped.curve()


@pytest.mark.parametrize(
    ("call", "command"),
    [
        (lambda: Run("nowhere"), ["evaluate", "checkpoint=nowhere"]),
        (lambda: marl_clean.load_policy("nowhere"), ["evaluate", "checkpoint=nowhere"]),
        (lambda: marl_clean.evaluate("nowhere"), ["evaluate", "checkpoint=nowhere"]),
        (lambda: marl_clean.evaluate(intervention="zero"), ["evaluate", "intervention=zero"]),
        (
            lambda: marl_clean.evaluate("mine", intervention="zer"),
            ["evaluate", "checkpoint=mine", "intervention=zer"],
        ),
        (
            lambda: marl_clean.evaluate("mine", view_size=9),
            ["evaluate", "checkpoint=mine", "observation.view_size=9"],
        ),
        (lambda: marl_clean.train(topology="radiu"), ["train", "topology=radiu"]),
        (lambda: marl_clean.train(plans=["no.yaml"]), ["train", "evaluation.plans=[no.yaml]"]),
        (lambda: marl_clean.train(encoder="mlp"), ["train", "encoder=mlp"]),
        (lambda: marl_clean.train(name="mine", seed=7), ["train", "name=mine", "seed=7"]),
        (lambda: marl_clean.train(["seed=1,2"]), ["train", "seed=1,2"]),
        (lambda: marl_clean.compare("nowhere"), ["compare", "nowhere"]),
        (
            lambda: marl_clean.compare("mine", against="none"),
            ["compare", "mine", "--against", "none"],
        ),
    ],
)
def test_errors_are_the_commands(
    run: Run, call: Any, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(command) == cli.BAD_INPUT
    with pytest.raises(BadInput) as caught:
        call()
    assert capsys.readouterr().err.endswith(f"marl-clean: {caught.value}\n")
