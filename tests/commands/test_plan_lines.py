"""What a person is told while a plan is used: its size, what is left out, how far it is."""

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from omegaconf import DictConfig
from PIL import Image
from rich.console import Console

from marl_clean import build
from marl_clean.commands import evaluate, figure, train, watch
from marl_clean.commands._progress import EvaluationProgress
from marl_clean.config.compose import compose_config
from marl_clean.config.stored import compose_for_policy
from marl_clean.evaluation.evaluator import measure
from marl_clean.trainer.base import Trainer

LINE = (
    "flat.yaml: 5 x 7 cells of 0.5 m, 8 free in one region, 1 free cell in 1 other region left out"
)
LIMIT = 4 * 5 * 7 // 2 + 50


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A scan of 5 x 7 cells in the working directory, as settings."""
    rows = ("#######", "#...#.#", "#..#.##", "#...###", "#######")
    free = [[cell == "." for cell in row] for row in (*rows[:2], "#..####", *rows[3:])]
    Image.fromarray((np.array(free) * 254).astype(np.uint8)).save(tmp_path / "flat.pgm")
    (tmp_path / "flat.yaml").write_text(
        "image: flat.pgm\nresolution: 0.5\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    monkeypatch.chdir(tmp_path)
    settings = ["house=floorplan", "house.path=flat.yaml", "house.cell_metres=0.5"]
    return [*settings, "evaluation.houses=2", "evaluation.plans=[]"]


def quiet() -> Console:
    return Console(file=io.StringIO(), width=200)


def trained(cfg: DictConfig) -> None:
    """The start of the command alone, until training would begin."""

    class Enough(Exception):
        pass

    def stop(*_: object, **__: object) -> None:
        raise Enough

    with pytest.MonkeyPatch.context() as patch, pytest.raises(Enough):
        patch.setattr(Trainer, "train", stop)
        train.main(cfg, Path("runs/never"), quiet())


COMMANDS: dict[str, Callable[[DictConfig], object]] = {
    "evaluate": lambda cfg: evaluate.main(cfg, Path("out.json"), quiet()),
    "watch": watch.main,
    "figure": lambda cfg: figure.main("houses", cfg, quiet()),
    "train": trained,
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_reports_once_what_is_kept_of_the_plan(
    command: str, plan: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    COMMANDS[command](compose_config(plan))
    more = f"; 2 starts of at most {LIMIT} steps" if command == "evaluate" else ""
    assert capfd.readouterr().err == f"{LINE}{more}\n"


@pytest.mark.slow
@pytest.mark.parametrize("command", ["evaluate", "watch"])
def test_generated_houses_need_no_line(
    command: str, plan: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    COMMANDS[command](compose_config(["house=open", "house.rows=[2,2]", "evaluation.houses=1"]))
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_training_reports_the_plans_it_is_measured_on_once_each(
    plan: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    trained(compose_config([*plan, "evaluation.plans=[apartment,flat.yaml]"]))
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["flat.yaml", "apartment"]


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "limit"), [([], LIMIT), (["env.max_steps=9"], 9)])
def test_the_limit_in_the_line_is_that_of_the_episodes(
    settings: list[str], limit: int, plan: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    (entry,) = evaluate.main(compose_config([*plan, *settings]), Path("out.json"), quiet())
    assert {house["max_steps"] for house in entry["houses"]} == {limit}
    assert capfd.readouterr().err.endswith(f"; 2 starts of at most {limit} steps\n")


@pytest.mark.long
def test_an_entry_is_written_before_the_next_policy_is_measured(tmp_path: Path) -> None:
    """An interruption in the third policy leaves the two before it in the file."""
    settings = ["house=open", "house.rows=[3,3]", "house.cols=[3,3]", "evaluation.houses=2"]
    cfg = compose_for_policy(["checkpoint=approach_2_frontier", *settings])
    out, names = tmp_path / "out.json", []

    def interrupt(name: str, share: float) -> None:
        names.append(name)
        if len(set(names)) == 3:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(
            evaluate.EvaluationProgress, "show", lambda _, *arguments: interrupt(*arguments)
        )
        evaluate.main(cfg, out, quiet(), interventions=["zero"])
    own, changed = json.loads(out.read_text())
    assert own["policy"] == cfg.name and "listening" in own
    assert changed["policy"] == f"{cfg.name} | zero" and "change" in changed


@pytest.mark.slow
def test_progress_rises_to_one_whatever_the_memory_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = compose_config(["house=open", "house.rows=[3,3]", "house.cols=[5,5]"])
    cfg.evaluation.houses = 5
    monkeypatch.setattr("marl_clean.evaluation.evaluator.CELLS_AT_ONCE", 2 * 3 * 5)
    shares: list[float] = []
    measure(
        cfg,
        lambda env: build.make_planner(cfg, env),
        "planner",
        on_progress=lambda name, share: shares.append(share),
    )
    assert shares == sorted(shares) and 0 < shares[0] < 0.4 and shares[-1] == 1


def test_without_a_terminal_lines_show_the_time_left(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 40.0, 50.0, 90.0])
    monkeypatch.setattr("marl_clean.commands._progress.time.monotonic", lambda: next(clock))
    with EvaluationProgress(num_policies=2, every_seconds=30.0) as progress:
        progress.show("mine", 0.4)
        progress.show("mine", 1.0)
        progress.show("random", 0.5)
    assert capfd.readouterr().err.splitlines() == [
        "mine (1 of 2): 40 %, about 160 s left in all",
        "random (2 of 2): 50 %, about 30 s left in all",
    ]
