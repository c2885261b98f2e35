"""A study is frozen before it is run, holds to that, and says which of its rules is met."""

import copy
import io
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from omegaconf import OmegaConf
from rich.console import Console

import marl_clean
from marl_clean import cli
from marl_clean.commands import study, study_report, study_screen
from marl_clean.commands.frozen import FROZEN, read_frozen
from marl_clean.commands.study_plan import PLANNERS, read_study
from marl_clean.commands.study_screen import nothing_to_win
from marl_clean.commands.verdicts import judge, runs_of
from marl_clean.config.compose import compose_config
from marl_clean.config.config_hash import config_hash
from marl_clean.config.levels import conf_folder, read_level
from marl_clean.config.presets import study_of
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.evaluator import YARDSTICKS
from marl_clean.evaluation.records import make_entry, write_entries
from marl_clean.evaluation.rules import Outcome
from marl_clean.storage.lock import locked
from tests.families import family
from tests.reliability import short_jobs
from tests.reliability.short_jobs import BAD_SEED

pytestmark = pytest.mark.usefixtures("unchecked")

STUDY: dict[str, Any] = {
    "arms": {"silent": ["comm=none"], "plan": ["comm=plan"]},
    "seeds": [1, 2, 3],
    "budget": 10_000,
    "houses": 3,
    "measure": "T_90",
    "rules": {
        "sooner": {"arm": "plan", "ratio_below": 0.95},
        "much_sooner": {"arm": "plan", "than": "silent", "ratio_below": 0.5},
        "beats_planner": {"arm": "plan", "than": "nearest_unknown", "difference_below": -60},
        "finishes": {"arm": "plan", "measure": "finished", "above": 0.9},
    },
}
MEANS = {"silent": 1000, "plan": 800, "oracle": 700}  # planted T_90
PLANNER = 860
FOLDER = Path("runs/studies/quick")


def train_here(monkeypatch, place: Path) -> list[str]:
    """Go to a folder; return the names of runs that a stand-in for training is asked for there."""
    monkeypatch.chdir(place)
    names = []

    def main(config, folder, console=None):
        with locked(folder):
            assert (folder.parent / FROZEN).is_file()  # frozen before anything is run
            names.append(folder.name)
            if config.seed == BAD_SEED:
                raise RuntimeError("thirteen")
            short_jobs.finish(config, folder)
            rng = np.random.default_rng(config.seed)
            times = MEANS[folder.name.partition("-")[0]] + rng.normal(0, 1, 20)
            write_entries(folder / "evaluation.json", entries(config, times))

    short_jobs.train_by(monkeypatch, main=main)
    return names


@pytest.fixture
def trained(tmp_path, monkeypatch) -> list[str]:
    """The names of runs that a stand-in for training was asked for, in an empty folder."""
    return train_here(monkeypatch, tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A folder in which the study was run; not to be changed."""
    place = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        names = train_here(patch, place)
        assert run(patch)[0] == 0 and len(names) == 6
    return place


@pytest.fixture
def studied(whole, tmp_path, monkeypatch) -> list[str]:
    """The names of runs that are trained from now on, where the study was run already."""
    shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    return train_here(monkeypatch, tmp_path)


def entries(config, times) -> list[dict[str, Any]]:
    [record, *_] = short_jobs.houses(0)
    sides = {config.name: times, "nearest_unknown": PLANNER + 0 * times}
    return [
        make_entry(
            name, "test", "hash", 0.0, 2,
            [record | {"seed": i, "T_90": float(t)} for i, t in enumerate(values)],
        )
        for name, values in sides.items()
    ]  # fmt: skip


def run(monkeypatch, section: dict[str, Any] = STUDY, *settings: str) -> tuple[int, str]:
    """The exit code of the study on top of the preset `quick`, and what it prints."""
    monkeypatch.setattr(study, "section_of", lambda preset: copy.deepcopy(section))
    out = io.StringIO()
    console = Console(file=out, width=250)
    code = study.main("quick", ["hydra/launcher=basic", *settings], console)
    return code, out.getvalue()


def changed(**keys: Any) -> dict[str, Any]:
    return copy.deepcopy(STUDY) | keys


def verdicts(folder: Path = FOLDER) -> dict[str, Outcome]:
    frozen = read_frozen(folder)
    return {v.rule.name: v.outcome for v in judge(frozen, runs_of(frozen))}


@pytest.mark.long
def test_a_study_may_be_a_file_anywhere(trained, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    path = tmp_path / "elsewhere" / "delay.yaml"
    path.write_text(yaml.safe_dump({"study": STUDY}, sort_keys=False))
    quiet = Console(file=io.StringIO())
    assert study.main(str(path), ["hydra/launcher=basic"], quiet) == 0
    folder = Path("runs/studies/delay")
    assert trained == [f"{arm}-s{seed}" for arm in STUDY["arms"] for seed in (1, 2, 3)]
    assert verdicts(folder)["sooner"] is Outcome.MET
    own = load_config(folder / "plan-s2")
    expected = compose_config(["comm=plan", "seed=2", "trainer.total_frames=10_000"])
    assert own["trainer"] == expected.trainer and own["evaluation"]["houses"] == 3
    trained.clear()
    decided = marl_clean.study(path, ["hydra/launcher=basic"])
    assert [verdict.rule.name for verdict in decided] == list(STUDY["rules"])
    assert not trained  # all are finished


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("study: 3", "has no section `study`"),
        ("[1, 2]", "has no section `study`"),
        ("study: {arms: {}}\nagent: {lr: 1}", "agent: only a preset sets keys"),
    ],
)
def test_a_file_that_is_no_study_is_one_line(tmp_path, content, message):
    (tmp_path / "no.yaml").write_text(content)
    with pytest.raises(BadInput, match=message):
        study.section_of(str(tmp_path / "no.yaml"))
    with pytest.raises(BadInput, match=r"gone\.yaml: No such file"):
        study.section_of(str(tmp_path / "gone.yaml"))


@pytest.mark.slow
def test_a_study_is_run_and_its_rules_are_decided(trained, monkeypatch):
    code, out = run(monkeypatch)
    assert code == 0 and "6 jobs: 6 finished" in out
    assert trained == [f"{arm}-s{seed}" for arm in STUDY["arms"] for seed in (1, 2, 3)]
    assert verdicts() == {
        "sooner": Outcome.MET,
        "much_sooner": Outcome.NOT_MET,
        "beats_planner": Outcome.UNDECIDED,  # 800 - 860, but for noise
        "finishes": Outcome.MET,
    }
    page = (FOLDER / "report.html").read_text()
    for text in ("T_90: plan / silent &lt; 0.95", "undecided", "not met", "plan-s3"):
        assert text in page
    frozen = read_frozen(FOLDER)
    config = load_config(FOLDER / "plan-s2")
    assert (config["seed"], config["trainer"]["total_frames"]) == (2, 10_000)
    assert config["evaluation"]["houses"] == 3
    alone = ["experiment=quick", "comm=plan", "seed=2"]
    alone += ["trainer.total_frames=10000", "evaluation.houses=3"]
    assert frozen.hashes["plan", 2] == config_hash(compose_config(alone))

    before = (FOLDER / FROZEN).read_bytes()
    assert run(monkeypatch)[0] == 0 and len(trained) == 6  # nothing is lacking
    assert (FOLDER / FROZEN).read_bytes() == before
    assert cli.main(["report", "quick", "--out", "page.html"]) == 0
    made_by = re.compile("<metadata>.*?</metadata>", re.DOTALL)  # names the command: another one
    assert made_by.sub("", Path("page.html").read_text()) == made_by.sub("", page)


@pytest.mark.long
def test_a_failed_seed_stays_and_decides_nothing(trained, monkeypatch):
    code, out = run(monkeypatch, changed(seeds=[1, 13, 2]))
    assert code == 1 and "4 finished, 2 failed" in out
    assert "silent-s13 failed, plan-s13 failed" in out
    assert verdicts()["sooner"] is Outcome.UNDECIDED
    page = (FOLDER / "report.html").read_text()
    assert "RuntimeError: thirteen" in page and page.count("plan-s13 failed") == 4
    frozen = read_frozen(FOLDER)
    [first, *_] = judge(frozen, runs_of(frozen))
    assert first.seeds == [1, 2] and first.effect.value == pytest.approx(0.8, abs=0.01)


@pytest.mark.long
def test_runs_that_are_missing_leave_the_rest(studied):
    for name in ("plan-s1", "plan-s2", "plan-s3"):
        (FOLDER / name).rename(FOLDER.parent / name)
    study_report.main(FOLDER, console=Console(quiet=True))
    page = (FOLDER / "report.html").read_text()
    assert "3 finished, 3 waiting of 6" in page and "plan-s1 waiting" in page
    assert set(verdicts().values()) == {Outcome.UNDECIDED}
    for name in ("silent-s1", "silent-s2", "silent-s3"):
        (FOLDER / name).rename(FOLDER.parent / name)
    study_report.main(FOLDER, console=Console(quiet=True))
    assert "6 waiting of 6" in (FOLDER / "report.html").read_text()


@pytest.mark.slow
def test_a_run_of_another_config_is_not_counted(studied):
    config = yaml.safe_load((FOLDER / "plan-s1/config.yaml").read_text())
    config["trainer"]["total_frames"] += 1
    (FOLDER / "plan-s1/config.yaml").write_text(yaml.safe_dump(config))
    frozen = read_frozen(FOLDER)
    reasons = {run.folder.name: run.reason for run in runs_of(frozen)}
    assert reasons["plan-s1"] == "another config than the registered one"
    assert verdicts()["sooner"] is Outcome.UNDECIDED


CHANGES: list[tuple[dict[str, Any], str]] = [
    ({"seeds": [1, 2, 3, 4]}, "seeds=[1, 2, 3], not [1, 2, 3, 4]"),
    ({"measure": "T_100"}, "measure=T_90, not T_100"),
    ({"confidence": 0.9}, "confidence=0.95, not 0.9"),
    ({"budget": 20_000}, "budget=10000, not 20000"),
    ({"rules": {"sooner": {"arm": "plan", "ratio_below": 0.99}}}, "sooner.ratio_below=0.95, not"),
    ({"rules": STUDY["rules"] | {"more": {"arm": "plan", "below": 9}}}, "with no study.rules.more"),
    ({"arms": {**STUDY["arms"], "third": ["comm=dgn"]}}, "arms silent, plan, not silent, pl"),
    ({"arms": {**STUDY["arms"], "plan": ["agent.lr=0.1"]}}, "agent.lr=0.001 in arm plan, not"),
]


@pytest.mark.long
def test_a_changed_study_is_one_line(studied, monkeypatch):
    before = (FOLDER / FROZEN).read_bytes()
    for keys, named in CHANGES:
        with pytest.raises(BadInput, match="begin a new study") as refused:
            run(monkeypatch, changed(**keys))
        assert named in str(refused.value) and "\n" not in str(refused.value)
    assert not studied and (FOLDER / FROZEN).read_bytes() == before
    assert run(monkeypatch, changed(question="Is it so?"), "logger=[csv]")[0] == 0
    assert not studied  # which are outside of the hash
    keys, _ = CHANGES[4]
    run(monkeypatch, changed(**keys, seeds=[1]), "name=second")
    assert len(studied) == 2 and len(verdicts(FOLDER.parent / "second")) == 1


@pytest.mark.slow
def test_a_study_changed_by_hand_is_one_line(studied, monkeypatch, capsys):
    path = FOLDER / FROZEN
    path.write_text(path.read_text().replace("ratio_below: 0.95", "ratio_below: 0.99"))
    assert cli.main(["report", str(FOLDER)]) == 2
    assert "was changed after it was frozen" in capsys.readouterr().err
    with pytest.raises(BadInput, match="was changed after it was frozen"):
        run(monkeypatch)
    path.unlink()  # which does not make the results newer than the rules
    with pytest.raises(BadInput, match="plan-s1, which was run before a study was frozen here"):
        run(monkeypatch)


@family(
    ("keys", "named"),
    [
        ({"arms": {}}, "study.arms: is empty"),
        ({"rules": {}}, "study.rules: is empty"),
        ({"seeds": []}, "study.seeds: must be a list"),
        ({"oracle": "all"}, "study.oracle: all: no such one"),
        ({"oracle": "a"}, "study.oracle: a is the baseline"),
        ({"seeds": [1, 1]}, "study.seeds: 1 stands there twice"),
        ({"arms": {"a/b": []}}, "study.arms.a/b: must be named by letters"),
        ({"arms": {"random": []}}, "study.arms.random: is the name of a planner"),
        ({"arms": {"a": ["comm=plam"]}}, "did you mean plan?"),
        ({"arms": {"a": ["seed=3"]}}, "study.arms.a: seed: belongs in study.seeds"),
        ({"arms": {"a": ["evaluation.houses=3"]}}, "belongs in study.houses"),
        ({"arms": {"a": ["name=x"]}}, "is the study's to choose"),
        ({"arms": {"a": ["comm=plan,none"]}}, "several values"),
        ({"arms": {"a": [], "b": ["comm=plan"]}}, "study.arms.b: makes the same runs as a"),
        ({"arms": {"a": ["env.n_agents=99"]}}, "env.n_agents"),
        ({"measure": "T_9"}, "study.measure: T_9: no such one; did you mean T_9"),
        ({"baseline": "nobody"}, "study.baseline: nobody: no such one"),
        ({"budgt": 1}, "study.budgt: no such key; did you mean budget?"),
        ({"budget": "hug"}, "budget=hug: no such level"),
        ({"rules": {"r": {"arm": "b", "below": 1}}}, "study.rules.r.arm: b: no such one"),
        ({"rules": {"r": {"arm": "a"}}}, "study.rules.r: has no bound"),
        ({"rules": {"r": {"arm": "a", "below": 1, "above": 2}}}, "has below and above"),
        ({"rules": {"r": {"below": 1}}}, "study.rules.r.arm: is missing"),
        ({"rules": {"r": {"arm": "a", "ratio_below": -1}}}, "study.rules.r.ratio_below: must be"),
        ({"rules": {"r": {"arm": "a", "ratio_below": 1}}}, "study.rules.r.than: a is the arm"),
        ({"rules": {"r": {"arm": "a", "than": "a", "below": 1}}}, "is a bound on the arm alone"),
        ({"rules": {"r": {"arm": "a", "measure": "T_certify", "below": 1}}}, "is not measured in"),
        ({"rules": {"r": {"arm": "a", "than": "random", "measure": "return", "ratio_above": 1}}},
         "may be negative"),
        ({"arms": {"a": [], "c": ["house.rows=[9,9]"]},
          "rules": {"r": {"arm": "c", "difference_below": 1}}}, "in other houses"),
    ],
    fast=6,
)  # fmt: skip
def test_bad_studies_are_one_line_and_nothing_is_run(keys, named, trained, monkeypatch):
    sound = {
        "arms": {"a": ["trainer.start_frames=0"]},
        "seeds": [1],
        "measure": "T_90",
        "rules": {"r": {"arm": "a", "below": 100}},
    }
    with pytest.raises(BadInput) as refused:
        run(monkeypatch, sound | keys)
    assert named in str(refused.value) and "\n" not in str(refused.value)
    assert not trained and not list(Path().iterdir())


@pytest.mark.long
def test_an_arm_may_start_from_a_preset_of_its_own(trained, monkeypatch):
    monkeypatch.setitem(MEANS, "own", 500)
    arms = {"plan": [], "own": ["experiment=paper_proximity", "house=apartment"]}
    rules = {"r": {"arm": "own", "below": 600}}
    run(monkeypatch, changed(arms=arms, rules=rules, seeds=[1, 2]))
    config = load_config(FOLDER / "own-s1")
    assert config["train_houses"] == compose_config(["experiment=paper_proximity"]).train_houses
    assert config["house"]["path"] == "apartment" and verdicts() == {"r": Outcome.MET}


@pytest.mark.long
def test_a_study_on_the_command_line_may_be_shorter(trained, monkeypatch):
    short = changed(seeds=[1])
    run(monkeypatch, short, "budget=smoke", "name=try")
    folder = FOLDER.parent / "try"
    assert load_config(folder / "plan-s1")["trainer"]["total_frames"] == 6_144
    with pytest.raises(BadInput, match=r"trainer.total_frames=6144 in arm silent, not 10000"):
        run(monkeypatch, short, "name=try")


@pytest.mark.slow
def test_a_study_is_reported_alone(studied):
    assert study_report.folder_in(["quick"]) == FOLDER
    assert study_report.folder_in([str(FOLDER)]) == FOLDER
    assert study_report.folder_in([str(FOLDER / "plan-s1")]) is None
    with pytest.raises(BadInput, match="quick is a study; give it alone"):
        study_report.folder_in(["other", "quick"])


@pytest.mark.slow
def test_the_section_changes_no_config():
    """A preset with a study makes the runs of the same preset without it."""
    with_study = compose_config(["experiment=quick_study"])
    assert "study" not in with_study
    assert study_of(conf_folder() / "experiment/quick_study.yaml") is not None
    assert study_of(conf_folder() / "experiment/quick.yaml") is None


def test_planners_are_those_that_training_measures():
    labels = []
    for name, settings in YARDSTICKS:
        section = OmegaConf.create({**read_level("planner", name), **settings})
        labels.append(instantiate(section).label)
    assert tuple(labels) == PLANNERS


def test_shipped_studies_are_valid():
    for path in sorted((conf_folder() / "experiment").glob("*.yaml")):
        if (section := study_of(path)) is not None:
            _, rules = read_study(section)
            assert all(rule.says for rule in rules)


@pytest.mark.long
def test_an_oracle_is_screened_first_and_shares_are_recovered_from_it(trained, monkeypatch):
    """Where all share a map, merged maps tell nobody anything new."""
    monkeypatch.setattr(study_screen, "HOUSES", 10)
    arms = {**STUDY["arms"], "oracle": ["env.memory=merged", "topology=full"]}
    code, out = run(monkeypatch, changed(arms=arms, oracle="oracle", seeds=[1, 2]))
    assert code == 0 and len(trained) == 6
    assert (
        "study.oracle: nearest_unknown has the same T_90 in arms silent and oracle in every" in out
    )
    assert "nothing to win, or nothing that a planner uses" in out
    assert "study.arms: networks of" in out and "weights in silent and" in out
    page = (FOLDER / "report.html").read_text()
    assert "<h2>Recovered</h2>" in page.replace(' class="', "")
    assert "0.67 [0.6" in page  # (1000 - 800) / (1000 - 700)
    code, out = run(monkeypatch, changed(arms=arms, oracle="oracle", seeds=[1, 2]))
    assert code == 0 and "nothing to win" not in out  # it is frozen


@pytest.mark.long
def test_an_oracle_that_gains_is_no_news(trained, monkeypatch):
    monkeypatch.setattr(study_screen, "HOUSES", 20)
    arms = {"silent": ["env.memory=private"], "oracle": ["env.memory=merged", "topology=full"]}
    rules = {"wins": {"arm": "oracle", "ratio_below": 0.9}}
    code, out = run(monkeypatch, changed(arms=arms, rules=rules, oracle="oracle", seeds=[1]))
    assert code == 0 and "nothing to win" not in out and "networks of" not in out
    configs = {arm: compose_config(["experiment=quick", *own]) for arm, own in arms.items()}
    swapped = {"baseline": "oracle", "oracle": "silent", "measure": "T_90"}
    line = nothing_to_win(swapped, configs)
    assert line is not None and line.startswith("study.oracle: nothing to win: T_90 of nearest")
    assert line.endswith("in arms oracle and silent, not clearly better in 20 validation houses")
