"""`marl-clean train`: train, choose weights on validation houses, measure, draw."""

import logging
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from marl_clean import build, files
from marl_clean.compose import compose_config
from marl_clean.evaluation.evaluator import measure_beside_planners, measure_planner, validate
from marl_clean.evaluation.records import Entry, read_entries, write_entries
from marl_clean.evaluation.table import make_table, output
from marl_clean.report.curve import draw_curve
from marl_clean.report.replay import make_replay
from marl_clean.schema import instantiate
from marl_clean.stored import CONFIG
from marl_clean.trainer.off_policy import Outcome

MEASURED = "evaluation.json"


def main(cfg: DictConfig, folder: Path, console: Console | None = None) -> list[Entry]:
    """Run `cfg` in `folder`: train or go on, then measure the best weights and draw.

    The test houses are measured once, after training, beside the planners, and then every plan
    of `evaluation.plans`. What is done already is not done again.

    Raises:
        BadInput: settings that do not fit each other; then no folder is made.
        SystemExit: 143 or 130 after a signal, when the state is saved.
    """
    console = console or output()
    outcome = train(cfg, folder)
    if outcome.was_finished and (folder / MEASURED).is_file():
        console.print(f"{folder} is finished: {outcome.frames:,} frames", soft_wrap=True)
        entries = read_entries(folder / MEASURED)
    else:
        entries = measure_all(cfg, folder)
        write_entries(folder / MEASURED, entries)
        draw(cfg, folder)
    for house_set in dict.fromkeys(entry["house_set"] for entry in entries):
        console.print(make_table([e for e in entries if e["house_set"] == house_set]))
    console.print(f"in {folder}: {MEASURED}, curve.png, replay.gif, checkpoints", soft_wrap=True)
    return entries


def train(cfg: DictConfig, folder: Path) -> Outcome:
    """Train until the budget is spent; the folder is made when everything is built."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every buffer it makes
    torch.manual_seed(cfg.seed)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    trainer = instantiate(cfg.trainer)
    loggers = [instantiate(section, folder=folder) for section in cfg.logger.values()]
    folder.mkdir(parents=True, exist_ok=True)
    files.write_file(folder / CONFIG, [OmegaConf.to_yaml(cfg, resolve=True).encode()])
    return trainer.train(env, agent, lambda policy: validate(cfg, policy), loggers, folder)


def measure_all(cfg: DictConfig, folder: Path) -> list[Entry]:
    """Measure the best weights and the planners on held-out houses and on each plan."""
    policy = build.load_policy(folder).to(cfg.device)
    entries = measure_beside_planners(cfg, policy, cfg.name)
    for plan in cfg.evaluation.plans:
        entries += measure_beside_planners(on_plan(cfg, plan), policy, cfg.name)
    return entries


def on_plan(cfg: DictConfig, plan: str) -> DictConfig:
    """Return the same config in the house of a floor plan file."""
    there = cfg.copy()
    there.house = compose_config(["house=floorplan", f"house.path={plan}"]).house
    return there


def draw(cfg: DictConfig, folder: Path) -> None:
    """Draw the learning curve beside nearest_unknown, and an episode of the policy."""
    rival = cfg.copy()
    rival.planner = compose_config(["planner=nearest_unknown"]).planner
    rival.evaluation.house_set = "validation"
    summary = measure_planner(rival)["summary"]
    means = {name: measure["mean"] for name, measure in summary.items()}
    means = {name: mean for name, mean in means.items() if mean is not None}
    draw_curve(folder / "metrics.csv", folder / "curve.png", means)
    policy = build.load_policy(folder).to(cfg.device)
    make_replay(cfg, lambda env: policy, folder / "replay.gif", cfg.evaluation.epsilon)
