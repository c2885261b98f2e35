"""Searches: what is asked, told, stopped, resumed and refused."""

import csv
import io
from pathlib import Path

import pytest
from omegaconf import OmegaConf
from rich.console import Console

import marl_clean
from marl_clean import cli
from marl_clean.commands import tune
from marl_clean.commands._space import Dimension, read_space
from marl_clean.commands._tune_settings import COLUMNS, VALIDATION, measure_of, read_settings
from marl_clean.config.compose import compose_config
from marl_clean.errors import BadInput
from marl_clean.storage.lock import locked
from marl_clean.trainer._outcome import Outcome
from tests.reliability.short_jobs import train_by
from tests.trainer.killing import Killed

LR = "agent.lr=tag(log,interval(1e-4,1e-2))"
EVALUATIONS = 4


class Trainings:
    """A stand-in for training: runs of four evaluations whose T_90 is 100 + 1e4 lr, falling.

    Attributes:
        begun: a run's settings lr, comm and seed for each training, in order.
        rows: logged in all.
        dies_at: the row at which the process is killed.
    """

    def __init__(self) -> None:
        self.begun: list[tuple[float, str, int]] = []
        self.rows = 0
        self.dies_at: int | None = None

    def train(self, config, folder, begin, more_loggers=()):
        comm = config.comm._target_.split(".")[2]
        self.begun.append((config.agent.lr, comm, config.seed))
        if comm == "zeroed":
            raise RuntimeError("no\nmessage")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "config.yaml").write_text(OmegaConf.to_yaml(config))
        begin()
        metrics = folder / "metrics.csv"
        if not metrics.is_file():
            metrics.write_text("frames,loss,validation/T_90\n")
        frames, final = 0, 100 + 1e4 * config.agent.lr + config.seed
        interval = config.trainer.eval_interval_frames
        for number in range(metrics.read_text().count("\n"), EVALUATIONS + 1):
            frames, value = number * interval, final + 8 * (EVALUATIONS - number)
            with metrics.open("a") as file:
                file.write(f"{frames},{number / 2},{value}\n")
            self.rows += 1
            if self.rows == self.dies_at:
                raise Killed
            for logger in more_loggers:
                logger.log(frames, {"loss": number / 2, "validation/T_90": value})
        return Outcome(frames, 1, None, False)


@pytest.fixture
def trainings(tmp_path, monkeypatch) -> Trainings:
    pytest.importorskip("optuna", reason="extra `tune`")
    monkeypatch.chdir(tmp_path)
    trainings = Trainings()
    train_by(monkeypatch, train=trainings.train)
    return trainings


def search(*settings: str) -> tuple[int, str]:
    """The exit code of a search by T_90 in four evaluations a run, and what it prints."""
    out = io.StringIO()
    budget = ["trainer.total_frames=4000", "trainer.eval_interval_frames=1000"]
    code = tune.run(["tune.measure=T_90", *settings, *budget], Console(file=out, width=200))
    return code, out.getvalue()


def trials(name: str) -> list[dict[str, str]]:
    with (Path("runs/tune") / name / "trials.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_search_and_the_same_command_again(trainings):
    code, table = search(LR, "tune.trials=3", "tune.name=a")
    rows = trials("a")
    assert code == 0 and len(trainings.begun) == 3
    assert [float(row["agent.lr"]) for row in rows] == [lr for lr, _, _ in trainings.begun]
    best = min(rows, key=lambda row: float(row["T_90"]))
    lines = table.splitlines()
    assert lines[3].split()[:3] == [best["trial"], f"{float(best['T_90']):.4g}", "complete"]
    command = f"  marl-clean train -m agent.lr={best['agent.lr']} "
    assert next(line for line in lines if line.startswith(command)).endswith("seed=1,2,3,4,5")
    assert "3 trials: 3 complete; all in runs/tune/a/trials.csv" in table
    assert {path.name for path in Path("runs/tune/a").iterdir()} == {"study.db", "trials.csv"}
    assert (Path("runs") / best["runs"] / "config.yaml").is_file()

    assert search(LR, "tune.trials=3", "tune.name=a") == (code, table)
    assert len(trainings.begun) == 3
    search(LR, "tune.trials=5", "tune.name=a")
    assert len(trainings.begun) == 5 and trials("a")[:3] == rows

    import optuna

    study = optuna.load_study(study_name="tune", storage="sqlite:///runs/tune/a/study.db")
    assert study.best_value == min(float(row["T_90"]) for row in trials("a"))


@pytest.mark.slow
@pytest.mark.parametrize("row", [6, 8])  # in the middle of the second trial, and at its last row
def test_a_killed_search_goes_on_as_if_it_had_not_been(trainings, row):
    search(LR, "tune.trials=5", "tune.name=whole", "name=whole")
    whole, trainings.rows, trainings.dies_at = trials("whole"), 0, row
    with pytest.raises(Killed):
        search(LR, "tune.trials=5", "tune.name=killed", "name=killed")
    before = len(trainings.begun)
    search(LR, "tune.trials=5", "tune.name=killed", "name=killed")
    killed = trials("killed")
    assert trainings.begun[before] == trainings.begun[before - 1]  # it is resumed first
    for row in (*whole, *killed):
        row.pop("runs")
    assert killed == whole
    assert trainings.rows == 5 * EVALUATIONS  # no row is made twice


@pytest.mark.slow
def test_a_trial_whose_process_always_dies_is_given_up(trainings):
    for _ in range(3):
        trainings.rows, trainings.dies_at = 0, 1
        Path("runs").mkdir(exist_ok=True)
        for path in Path("runs").glob("run-*/metrics.csv"):
            path.unlink()
        with pytest.raises(Killed):
            search(LR, "tune.trials=1", "tune.name=a")
        for path in Path("runs").glob("run-*/metrics.csv"):
            path.unlink()
    code, table = search(LR, "tune.trials=1", "tune.name=a")
    assert code == 1 and "its process was killed 3 times" in table


@pytest.mark.slow
def test_a_failed_trial_stands_in_the_table_and_stops_no_other(trainings):
    code, table = search("comm=plan,zeroed", LR, "tune.trials=6", "tune.name=a")
    failed = [row for row in trials("a") if row["state"] == "failed"]
    assert code == 0 and 0 < len(failed) < 6
    assert all(row["comm"] == "zeroed" for row in failed)
    assert table.count("RuntimeError: no message") == len(failed)
    [note] = Path("runs").glob(f"{failed[0]['runs']}/failed.txt")
    text = note.read_text()
    assert text.startswith("RuntimeError: no message\n\nsettings: comm=zeroed agent.lr=")
    assert "Traceback" in text


@pytest.mark.slow
def test_a_trial_that_its_check_refuses_is_a_failed_trial(trainings):
    code, table = search("env.n_agents=choice(2,90)", "tune.trials=8", "tune.name=a")
    assert code == 0 and "failed" in table and "more than 90 free cells" in table


@pytest.mark.slow
def test_the_median_stops_a_run(trainings):
    settings = [LR, "tune.trials=6", "tune.direction=maximize", "tune.prune_after=2"]
    search(*settings, "tune.name=a")
    states = [row["state"] for row in trials("a")]
    pruned = states.count("pruned")
    assert pruned and trainings.rows == 6 * EVALUATIONS - 3 * pruned  # after one evaluation each
    trainings.rows = 0
    search(*settings, "tune.prune_from=0.5", "tune.name=c", "name=c")
    assert [row["state"] for row in trials("c")] == states
    assert trainings.rows == 6 * EVALUATIONS - 2 * pruned
    search(*settings, "tune.pruner=none", "tune.name=b")
    assert [row["state"] for row in trials("b")] == ["complete"] * 6


@pytest.mark.slow
def test_the_mean_over_seeds(trainings):
    search(LR, "seed=4", "tune.seeds=3", "tune.trials=2", "tune.name=a")
    assert [seed for _, _, seed in trainings.begun] == [4, 5, 6] * 2
    for row in trials("a"):
        assert float(row["T_90"]) == pytest.approx(100 + 1e4 * float(row["agent.lr"]) + 5)
        assert len(set(row["runs"].split())) == 3


@pytest.mark.slow
def test_a_column_of_metrics_csv(trainings):
    code, table = search(LR, "tune.measure=loss", "tune.trials=1", "tune.name=a")
    assert code == 0 and trials("a")[0]["loss"] == "2.0"
    code, table = search(LR, "tune.measure=stage", "tune.direction=maximize", "tune.trials=1")
    assert code == 1 and "metrics.csv has no value of it" in table


@pytest.mark.slow
def test_a_run_that_another_process_trains_is_left_to_it(trainings, capsys):
    first = read_space([LR, "trainer.total_frames=4000", "trainer.eval_interval_frames=1000"])
    search(LR, "tune.trials=1", "tune.name=a")
    [row] = trials("a")
    name = first.config({"agent.lr": row["agent.lr"]}).name
    assert row["runs"] == name
    with locked(Path("runs") / name):
        code, table = search(LR, "tune.trials=1", "tune.name=b")
    assert code == 1 and "1 trials: 1 unfinished" in table
    assert "left to another process" in capsys.readouterr().err
    assert search(LR, "tune.trials=1", "tune.name=b")[0] == 0


@pytest.mark.slow
def test_a_database_is_opened_by_one_process_at_a_time(trainings, monkeypatch):
    from marl_clean.commands import _tune_study

    monkeypatch.setattr(_tune_study, "OPENING_TRIES", 1)
    with locked(Path("runs/tune/a/opening")), pytest.raises(BadInput, match="opening: held by"):
        search(LR, "tune.trials=1", "tune.name=a")
    assert search(LR, "tune.trials=1", "tune.name=a")[0] == 0


@pytest.mark.slow
def test_a_search_of_another_name_or_a_damaged_one_is_one_line(trainings, capsys):
    given = ["tune", LR, "tune.trials=1", "tune.measure=T_90", "tune.name=a"]
    assert cli.main(given) == 0
    capsys.readouterr()
    changed = {
        "agent.lr=interval(1e-4,1e-2)": "a search with another space: agent.lr: 0.0001 to 0.01, l",
        "agent.gamma=0.5": "another fixed config",
        "tune.measure=T_95": "another measure: T_90, minimize, not T_95, minimize; choose another",
        "tune.direction=maximize": "another measure: T_90, minimize, not T_90, maximize",
        "tune.seeds=2": "another number of seeds: 1, not 2",
    }
    for setting, reason in changed.items():
        assert cli.main([*given, setting]) == cli.BAD_INPUT
        err = capsys.readouterr().err
        assert reason in err and err.count("\n") == 1
    database = Path("runs/tune/a/study.db")
    whole = database.read_bytes()
    for damaged in (b"not a database", whole[: len(whole) // 2], whole[:100] + b"x" * 20_000):
        database.write_bytes(damaged)
        assert cli.main(given) == cli.BAD_INPUT
        err = capsys.readouterr().err
        assert err.startswith(f"marl-clean: {database}: is damaged") and err.count("\n") == 1
    assert len(trainings.begun) == 1


def test_a_study_is_no_search() -> None:
    with pytest.raises(BadInput, match="experiment=quick_study: is a study of several arms"):
        tune.make_plan(["+experiment=quick_study", LR])


def test_python_gets_the_trials(trainings) -> None:
    made = marl_clean.tune([LR], trials=3, measure="T_90", name="mine", seed=1)
    assert [trial["trial"] for trial in made] == [0, 1, 2]
    assert all(trial["state"] == "complete" and len(trial["runs"]) == 1 for trial in made)
    measured = [trial["T_90"] for trial in made]
    assert measured == pytest.approx([100 + 1e4 * float(trial["agent.lr"]) for trial in made])
    with pytest.raises(BadInput, match="tune: trial: no such setting; did you mean trials"):
        marl_clean.tune([LR], trial=3)


@pytest.mark.slow
def test_without_optuna_one_line_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tune, "is_installed", lambda name: False)
    assert cli.main(["tune", LR]) == cli.BAD_INPUT
    assert capsys.readouterr().err.endswith("pip install 'marl-clean[tune]'\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_spaces_are_read_as_sweeps_are() -> None:
    space = read_space(
        [
            "comm=plan,none",
            "encoder.hidden=choice([64],[64,64])",
            "agent.n_steps=range(1,8,2)",
            "agent.gamma=range(0.9,1.0,0.03)",
            "env.n_agents=interval(1,4)",
            "evaluation.epsilon=interval(0,1)",
            "train_houses=tag(log,int(interval(8,64)))",
            "agent.lr=range(1,2)",
            "agent.lr=0.1",  # the last counts
        ]
    )
    assert space.dimensions == (
        Dimension("comm", ("none", "plan")),
        Dimension("encoder.hidden", ("[64,64]", "[64]")),
        Dimension("agent.n_steps", ("1", "3", "5", "7"), 1, 7, 2, whole=True),
        Dimension("agent.gamma", ("0.9", "0.93", "0.9600000000000001", "0.99"), 0.9, 0.99, 0.03),
        Dimension("env.n_agents", (), 1.0, 4.0, None, whole=True),
        Dimension("evaluation.epsilon", (), 0.0, 1.0),
        Dimension("train_houses", (), 8, 64, None, whole=True, log=True),
    )
    config = space.config({**space.first(), "encoder.hidden": "[64,64]", "env.n_agents": "3"})
    assert (config.encoder.hidden, config.env.n_agents, config.agent.lr) == ([64, 64], 3, 0.1)


@pytest.mark.parametrize(
    ("settings", "measured"),
    [
        ([], ("T_100", "validation/T_100", True, "minimize")),
        (["tune.measure=validation/T_90"], ("T_90", "validation/T_90", True, "minimize")),
        (["tune.measure=coverage"], ("coverage", "validation/coverage", True, "maximize")),
        (["tune.measure=reward"], ("reward", "reward", False, "maximize")),
        (
            ["tune.measure=contact", "tune.direction=maximize"],
            ("contact", "validation/contact", True, "maximize"),
        ),
    ],
)
def test_measures_and_their_direction(settings, measured) -> None:
    measure = measure_of(read_settings(settings), compose_config([]))
    assert measured == (measure.name, measure.column, measure.of_validation, measure.direction)


def test_single_values_are_no_search() -> None:
    with pytest.raises(BadInput, match="^tune: nothing is searched"):
        read_space(["agent.lr=0.1"])


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked", "one_thread")
def test_a_real_run_is_stopped_and_its_measures_have_names(tmp_path, monkeypatch):
    pytest.importorskip("optuna", reason="extra `tune`")
    monkeypatch.chdir(tmp_path)
    budget = (
        "+experiment=quick trainer.total_frames=768 trainer.eval_interval_frames=256"
        " env.num_envs=64 trainer.log_interval_frames=128 trainer.start_frames=64"
        " evaluation.houses=1 trainer.frames_per_batch=128 evaluation.plans=[] train_houses=8"
        " logger=[csv] trainer.replay_ratio=interval(0.2,2)"
    )
    settings = [*budget.split(), "tune.trials=3", "tune.prune_after=1", "tune.name=a"]
    measured = ["tune.measure=updates", "tune.direction=maximize"]
    assert tune.run([*settings, *measured], Console(file=io.StringIO())) == 0
    rows = trials("a")
    assert {row["state"] for row in rows} == {"complete", "pruned"}
    for row in rows:
        folder = Path("runs") / row["runs"]
        header, *logged = (folder / "metrics.csv").read_text().splitlines()
        names = header.split(",")
        own = {name for name in names if not name.startswith(VALIDATION)}
        assert own <= {*COLUMNS, "frames", "finished", "coverage"}
        whole = row["state"] == "complete"
        assert bool(list(folder.glob("checkpoints/final-*"))) is whole
        last = dict(zip(names, logged[-1].split(","), strict=True))
        assert float(last["updates"]) == float(row["updates"])
        assert (int(last["frames"]) == 768) is whole
        assert not (folder / "evaluation.json").exists()  # test houses are not for a search
