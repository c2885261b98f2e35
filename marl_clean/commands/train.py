"""`marl-clean train`: train, choose weights on validation houses, measure, draw."""

import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from marl_clean import build
from marl_clean.commands._plan_lines import write_plan_lines
from marl_clean.commands.command_line import command_line
from marl_clean.commands.run_record import recorded
from marl_clean.config.compose import compose_config, has_houses
from marl_clean.config.config_hash import config_hash
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import CONFIG, METRICS, find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.evaluator import (
    in_any_env,
    measure,
    measure_beside_planners,
    measure_planner,
    validate,
)
from marl_clean.evaluation.records import MEASURED, Entry, Torn, read_entries, write_entries
from marl_clean.evaluation.table import make_table, output
from marl_clean.logger.base import Logger
from marl_clean.report.curve import draw_curve
from marl_clean.report.metrics import read_metrics
from marl_clean.report.origin import Origin
from marl_clean.report.recorded import REPLAY, read_recording
from marl_clean.report.recording import make_recording
from marl_clean.report.replay import make_replay
from marl_clean.storage import files, manifest
from marl_clean.storage.lock import locked
from marl_clean.storage.pictures import is_whole
from marl_clean.trainer._first_updates import FirstUpdates
from marl_clean.trainer._outcome import Outcome
from marl_clean.trainer._share import share_maker

GIF = "replay.gif"
log = logging.getLogger(__name__)


def main(cfg: DictConfig, folder: Path, console: Console | None = None) -> list[Entry]:
    """Run `cfg` in `folder`: train or resume, then measure the best weights and draw.

    The test houses are measured once, after training, beside the planners, and then houses of
    `evaluation.sides`, plans of `evaluation.plans`, teams of `evaluation.team_sizes`. What is done
    already is not done again.

    Raises:
        BadInput: settings that do not fit each other; then no folder is made.
        Held: another process works in `folder`; the message names it.
        SystemExit: 143 or 130 after a signal, when the state is saved.
    """
    with locked(folder):
        return _main(cfg, folder, console or output())


def _main(cfg: DictConfig, folder: Path, console: Console) -> list[Entry]:
    with recorded(cfg, folder) as begin:
        entries = _made(cfg, folder, console, begin)
    for key in dict.fromkeys((entry["house_set"], entry["n_agents"]) for entry in entries):
        console.print(make_table([e for e in entries if (e["house_set"], e["n_agents"]) == key]))
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    console.print(f"in {folder}: {', '.join(names)}")
    return entries


def _made(
    cfg: DictConfig, folder: Path, console: Console, begin: Callable[[], None]
) -> list[Entry]:
    """Do what is not done yet; `begin` is called before any of it."""
    outcome = train(cfg, folder, begin)
    if outcome.was_finished:
        console.print(f"{folder} is finished: {outcome.frames:,} frames", soft_wrap=True)
    entries = measured_before(folder) if outcome.was_finished else None
    if entries is None:
        begin()
        entries = measure_all(cfg, folder)
        write_entries(folder / MEASURED, entries)
    if draw(cfg, folder):
        for section in cfg.logger.values():
            instantiate(section, folder=folder).add_replay(folder / GIF, outcome.frames)
    return entries


def train(
    cfg: DictConfig,
    folder: Path,
    begin: Callable[[], None],
    more_loggers: Sequence[Logger] = (),
    first_updates: FirstUpdates | None = None,
) -> Outcome:
    """Train until the budget is spent; the folder is made when everything is built.

    `begin` is called then, unless the run is finished. `more_loggers` log beside those of the
    config; what one raises ends the training. `first_updates`: what notes them.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports every buffer it makes
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    if cfg.checkpoint is not None:
        build.check_size(cfg, env, find_run(cfg.checkpoint))
    agent = build.make_agent(cfg, env)
    env = build.ready_for(agent, env)
    fixed = {} if has_houses(cfg) else {"select_by": "return"}  # an external task has no other
    trainer = instantiate(cfg.trainer, **fixed)
    trainer.check(env, agent)
    if cfg.checkpoint is not None:  # a resumed run puts its state over these weights
        build.start_from(agent, cfg)
    loggers = [instantiate(section, folder=folder) for section in cfg.logger.values()]
    loggers += more_loggers
    try:
        files.make_folder(folder)
        files.clear_leftovers(folder)
        write_config(cfg, folder / CONFIG)
    except OSError as error:
        raise BadInput(f"name={cfg.name}: {folder} cannot be written: {error.strerror}") from error
    if not manifest.paths(folder / manifest.FOLDER, "final"):
        begin()
    write_plan_lines(cfg, cfg.evaluation.plans)
    return trainer.train(
        env,
        agent,
        lambda policy: validate(cfg, policy),
        loggers,
        folder,
        start_is_candidate=cfg.checkpoint is not None,
        make_share=share_maker(cfg),
        first_updates=first_updates,
    )


def write_config(cfg: DictConfig, path: Path) -> None:
    """Write a run's config, unless the file holds it, so that a finished run needs no space."""
    text = OmegaConf.to_yaml(cfg, resolve=True).encode()
    if not path.is_file() or path.read_bytes() != text:
        files.write_file(path, [text])


def measured_before(folder: Path) -> list[Entry] | None:
    """What a finished run's evaluation.json holds; None where it is to be measured (again)."""
    if not (folder / MEASURED).is_file():
        return None
    try:
        return read_entries(folder / MEASURED)
    except Torn as error:
        log.warning("%s; measured again", error)
        return None


def measure_all(cfg: DictConfig, folder: Path) -> list[Entry]:
    """Measure the best weights and the planners in all `places`.

    Where training started from another run's weights, these are measured too, as `RUN before`: it
    shows what was gained in the new houses, and what was forgotten in the old ones.
    """
    cfg = cfg.copy()
    cfg.evaluation.house_set = "test"  # validation houses have chosen the weights
    policies = {cfg.name: build.load_policy(folder).to(cfg.device)}
    if cfg.checkpoint is not None:
        run = find_run(cfg.checkpoint)
        before = build.load_policy(run, cfg).to(cfg.device)
        policies[f"{load_config(run)['name']} before"] = before
    entries = []
    for place, house_set in places(cfg):
        own, *planners = measure_beside_planners(place, policies[cfg.name], cfg.name)
        before = [
            measure(place, partial(in_any_env, policy), name, epsilon=place.evaluation.epsilon)
            for name, policy in policies.items()
            if name != cfg.name
        ]
        measured = [own, *before, *planners]
        entries += [{**entry, "house_set": house_set or entry["house_set"]} for entry in measured]
    return entries


def places(cfg: DictConfig) -> list[tuple[DictConfig, str | None]]:
    """Return `cfg` in its own houses, in those of the run it started from, in houses of each size
    and in each plan, and with each size of team in its own houses.

    Each is listed once, with a name for its set of houses where `test` would be ambiguous.
    """
    chosen: list[tuple[DictConfig, str | None]] = [(cfg, None)]
    if not has_houses(cfg):
        return chosen
    if cfg.checkpoint is not None:
        stored, old = load_config(find_run(cfg.checkpoint)), cfg.copy()
        old.house = stored["house"]
        generated = instantiate(cfg.house).generated and instantiate(old.house).generated
        chosen.append((old, f"test of {stored['name']}" if generated else None))
    for side in cfg.evaluation.get("sides", []):
        chosen.append((of_side(cfg, side), f"test {side}x{side}"))
    chosen += [(on_plan(cfg, plan), None) for plan in cfg.evaluation.plans]
    chosen += [(of_team(cfg, size), None) for size in cfg.evaluation.get("team_sizes", [])]
    seen = [(place.house, place.env.n_agents) for place, _ in chosen]
    return [place for index, place in enumerate(chosen) if seen[index] not in seen[:index]]


def of_side(cfg: DictConfig, side: int) -> DictConfig:
    """Return the same config in square houses of rooms, `side` cells a side."""
    sized = cfg.copy()
    size = f"[{side},{side}]"
    sized.house = compose_config(["house=rooms", f"house.rows={size}", f"house.cols={size}"]).house
    return sized


def on_plan(cfg: DictConfig, plan: str) -> DictConfig:
    """Return the same config in the house of a floor plan file."""
    in_plan = cfg.copy()
    in_plan.house = compose_config(["house=floorplan", "house.path=apartment"]).house
    in_plan.house.path = plan
    return in_plan


def of_team(cfg: DictConfig, size: int) -> DictConfig:
    """Return the same config with another number of robots."""
    team = cfg.copy()
    team.env.n_agents = size
    return team


def draw(cfg: DictConfig, folder: Path) -> bool:
    """Draw what is not drawn yet: the learning curve beside nearest_unknown, and an episode.

    The episode is drawn as a GIF and recorded as data. Of an external task the curve alone.
    Return whether an episode was drawn.
    """
    metrics, curve, replay = (folder / name for name in (METRICS, "curve.png", GIF))
    if has_rows(cfg, metrics) and not drawn_before(curve):
        origin = Origin(command_line(), [config_hash(cfg)])
        draw_curve(metrics, curve, origin, planner_means(cfg) if has_houses(cfg) else None)
    recording = folder / REPLAY
    if not has_houses(cfg) or (drawn_before(replay) and recorded_before(recording)):
        return False
    policy = build.load_policy(folder).to(cfg.device)
    make_replay(cfg, lambda env: policy, replay, cfg.evaluation.epsilon)
    make_recording(cfg, lambda env: policy, recording, cfg.evaluation.epsilon)
    return True


def has_rows(cfg: DictConfig, metrics: Path) -> bool:
    """Whether what the run logged can be read; a line says so where it should be and cannot."""
    if "csv" not in cfg.logger and not metrics.exists():
        return False
    try:
        read_metrics(metrics)
    except BadInput as error:
        log.warning("%s; a finished run cannot write it again", error)
        return False
    return True


def drawn_before(picture: Path) -> bool:
    """Whether a picture is there, and whole; where it is not whole, a line says so."""
    if is_whole(picture):
        return True
    if picture.exists():
        log.warning("%s: is not whole; drawn again", picture)
    return False


def recorded_before(recording: Path) -> bool:
    """Whether an episode's recording is there, and whole; else as `drawn_before`."""
    if not recording.exists():
        return False
    try:
        read_recording(recording)
    except BadInput as error:
        log.warning("%s; recorded again", error)
        return False
    return True


def planner_means(cfg: DictConfig) -> dict[str, float]:
    """Measure nearest_unknown on the validation houses, where the learning curve is measured."""
    planned = cfg.copy()
    planned.planner = compose_config(["planner=nearest_unknown"]).planner
    planned.evaluation.house_set = "validation"
    summary = measure_planner(planned)["summary"]
    means = {name: measure["mean"] for name, measure in summary.items()}
    return {name: mean for name, mean in means.items() if mean is not None}
