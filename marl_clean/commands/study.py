"""`marl-clean study NAME|FILE.yaml`: the arms and seeds of a section `study`, as jobs of a sweep.

Every config is checked and the study is frozen into its folder before the first job starts. The
same command again does what is missing; a study that is not the frozen one is refused.
"""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich.console import Console

from marl_clean.commands.checks import check_all
from marl_clean.commands.frozen import (
    FROZEN,
    check_unchanged,
    freeze,
    read_frozen,
    run_name,
    to_freeze,
)
from marl_clean.commands.shorthand import with_floor_plans
from marl_clean.commands.study_plan import PLANNERS, Rule, read_study
from marl_clean.commands.study_screen import nothing_to_win, unequal_sizes
from marl_clean.commands.sweep import Job, run_jobs, runs_here, split
from marl_clean.config.compose import has_houses
from marl_clean.config.config_hash import config_hash, container
from marl_clean.config.hydra_adapter import Override
from marl_clean.config.levels import BUDGET, EXPERIMENT, level_file, levels_in
from marl_clean.config.overrides import check_single_values, parse_overrides
from marl_clean.config.presets import study_of
from marl_clean.config.schema import choices, mismatch
from marl_clean.config.stored import RUNS, parsed_for_training
from marl_clean.errors import BadInput
from marl_clean.evaluation.table import output
from marl_clean.settings import FolderName
from marl_clean.storage.safe_yaml import load_yaml

STUDIES = RUNS / "studies"
YAML = (".yaml", ".yml")
FRAMES, HOUSES = "trainer.total_frames", "evaluation.houses"
OF_THE_STUDY = {"seed": "seeds", "out": "none", "name": "none", BUDGET: "budget"}
OF_THE_STUDY |= {FRAMES: "budget", HOUSES: "houses"}
ON_DEMAND = {"certify": "certify", "optimum_100": "optimum", "gap_100": "optimum"}


def main(preset: str, settings: Sequence[str], console: Console | None = None) -> int:
    """Run what the study of `preset` lacks, and write its page; return the exit code of a sweep.

    `preset` may be a yaml file, wherever it is, with a section `study` alone: its arms start from
    the default config, or from presets that they name. `settings` are those of all arms
    (`device=cuda`), Hydra's own for launching, and `name=`.
    Raises BadInput before anything is written where a setting, an arm or a rule is wrong, or the
    study is not the one that is frozen in its folder.
    """
    section = section_of(preset)
    study, rules = read_study(section)
    of_jobs, of_hydra = split(settings)
    folder = _folder_of(preset, of_jobs)
    common = [override for override in of_jobs if override.key != "name"]
    start = None if preset.endswith(YAML) else preset
    jobs = {arm: jobs_of(start, study, arm, common, folder) for arm in study["arms"]}
    configs = {arm: [job.config for job in arms] for arm, arms in jobs.items()}
    check_comparable(rules, {arm: seeds[0] for arm, seeds in configs.items()})
    now = to_freeze(title_of(preset), study, configs)
    is_frozen = (folder / FROZEN).is_file()
    if is_frozen:
        check_unchanged(read_frozen(folder), now)
    every = [job for arms in jobs.values() for job in arms]
    for job in every:
        check_all(job.config, training=True, here=runs_here(of_hydra))
    if not is_frozen:
        firsts = {arm: seeds[0] for arm, seeds in configs.items()}
        for line in (nothing_to_win(study, firsts), unequal_sizes(firsts)):
            if line is not None:
                (console or output()).print(line, soft_wrap=True)
        freeze(folder, now)
    labels = {job.config.name: Path(job.config.name).name for job in every}
    code = run_jobs(every, of_hydra, labels, console)
    from marl_clean.commands import study_report

    study_report.main(folder, console=console)
    return code


def folder_of(preset: str, settings: Sequence[str]) -> Path:
    """The folder of a study: of the name in the settings, or the preset's or file's.

    Raises BadInput where that is no name of a folder.
    """
    return _folder_of(preset, split(settings)[0])


def _folder_of(preset: str, of_jobs: Sequence[Override]) -> Path:
    names = [o.value for o in of_jobs if o.key == "name" and o.value is not None]
    name = str(names[-1]) if names else title_of(preset)
    if problem := mismatch(name, FolderName):
        raise BadInput(f"name={name}: {problem}")
    return STUDIES / name


def title_of(preset: str) -> str:
    """The name of a study: its preset's, or its file's without the ending."""
    return Path(preset).stem if preset.endswith(YAML) else preset


def section_of(preset: str) -> dict[str, Any]:
    """The section `study` of a preset or a yaml file. Raises BadInput where there is none."""
    if preset.endswith(YAML):
        return section_in(Path(preset))
    presets = levels_in(EXPERIMENT)
    if preset not in presets:
        raise BadInput(f"study {preset}: no such preset; {choices(preset, presets)}")
    section = study_of(level_file(EXPERIMENT, preset))
    if section is None:
        studies = [name for name in presets if study_of(level_file(EXPERIMENT, name)) is not None]
        raise BadInput(
            f"study {preset}: the preset has no section `study`; {choices(preset, studies)}"
        )
    return section


def section_in(path: Path) -> dict[str, Any]:
    """The section `study` of a yaml file that holds nothing else.

    Raises BadInput where it cannot be read, has no such section or other keys.
    """
    values = load_yaml(path)
    if not isinstance(values, dict) or not isinstance(values.get("study"), dict):
        raise BadInput(f"study {path}: has no section `study` with arms, seeds, measure and rules")
    if others := [str(key) for key in values if key != "study"]:
        raise BadInput(
            f"study {path}: {others[0]}: only a preset sets keys beside its study; give them to"
            " the arms, as in plan: [experiment=quick, comm=plan]"
        )
    return dict(values["study"])


def jobs_of(
    preset: str | None,
    study: Mapping[str, Any],
    arm: str,
    common: Sequence[Override],
    folder: Path,
) -> list[Job]:
    """The runs of one arm, a seed each; without a preset it starts from the default config.

    Seed and name are all that sets them apart, so that one config is composed for all.
    Raises BadInput where its settings make no config.
    """
    try:
        own = parse_overrides(with_floor_plans(study["arms"][arm]))
        check_single_values(own)
        for override in own:
            if override.key in OF_THE_STUDY:
                raise BadInput(f"{override.key}: {_elsewhere(override.key)}")
    except BadInput as error:
        raise BadInput(f"study.arms.{arm}: {error}") from None
    keys = {override.key for override in common}
    for key in keys & ({override.key for override in own} | {"seed", "out", EXPERIMENT}):
        raise BadInput(f"{key}: is what sets the runs of a study apart; leave it out")
    check_single_values(common)
    # An arm that names a preset starts from it, and not from the study's.
    starts_anew = preset is None or EXPERIMENT in {override.key for override in own}
    start = [] if starts_anew else [f"{EXPERIMENT}={preset}"]
    budget, houses = study["budget"], study["houses"]
    if budget is not None and not keys & {BUDGET, FRAMES}:
        start.append(f"{FRAMES if isinstance(budget, int) else BUDGET}={budget}")
    if houses is not None and HOUSES not in keys:
        start.append(f"{HOUSES}={houses}")
    jobs: list[Job] = []
    for seed in study["seeds"]:
        name = (folder / run_name(arm, seed)).relative_to(RUNS).as_posix()
        apart = parse_overrides([f"seed={seed}", f"name={name}"])
        settings = [*parse_overrides(start), *common, *own, *apart]
        if jobs:
            config = copy.deepcopy(jobs[0].config)
            config.seed, config.name = seed, name
        else:
            config = _config_of(arm, settings)
        jobs.append(Job([override.setting for override in settings], config, RUNS / name))
    return jobs


def _config_of(arm: str, settings: Sequence[Override]) -> DictConfig:
    try:
        return parsed_for_training(settings)
    except BadInput as error:
        raise BadInput(f"study.arms.{arm}: {error}") from None


def _elsewhere(key: str) -> str:
    place = OF_THE_STUDY[key]
    return "is the study's to choose" if place == "none" else f"belongs in study.{place}"


def check_comparable(rules: Sequence[Rule], configs: Mapping[str, DictConfig]) -> None:
    """Raises BadInput where two arms are the same, or a rule's arms lack what it compares."""
    hashes: dict[str, str] = {}
    for arm, config in configs.items():
        other = hashes.setdefault(config_hash(config), arm)
        if other != arm:
            raise BadInput(f"study.arms.{arm}: makes the same runs as {other}; leave one out")
    for rule in rules:
        key = f"study.rules.{rule.name}"
        for arm in rule.arms:
            if not measured(rule.measure, configs[arm]):
                raise BadInput(f"{key}.measure: {rule.measure} is not measured in arm {arm}")
        if rule.than in PLANNERS[1:] and not has_houses(configs[rule.arm]):
            raise BadInput(f"{key}.than: {rule.than} needs houses, which env has none of")
        places = [_place(configs[arm]) for arm in rule.arms]
        for place in places[1:]:
            if place != places[0]:
                raise BadInput(
                    f"{key}: {' and '.join(rule.arms)} are measured in other houses, and cannot be "
                    "compared house by house"
                )


def measured(measure: str, config: DictConfig) -> bool:
    """Whether a run of this config will have the measure."""
    if not has_houses(config):
        return measure == "return"
    for ending, switch in ON_DEMAND.items():
        if measure.endswith(ending):
            return bool(config.evaluation.get(switch, False))
    return True


def _place(config: DictConfig) -> list[Any]:
    """What decides in which episodes a run is measured."""
    plain = container(config)
    task = None if has_houses(config) else plain["env"]
    return [plain["house"], plain["evaluation"]["houses"], task]
