"""`marl-clean matrix RUNS...`: policies trained over one channel, measured over all of them."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich import box
from rich.console import Console
from rich.table import Table

from marl_clean.commands.checks import check_all
from marl_clean.commands.command_line import command_line
from marl_clean.commands.labels import labels
from marl_clean.config.compose import checked, compose_config
from marl_clean.config.config_hash import OUTSIDE_THE_HASH
from marl_clean.config.stored import RUNS, find_run, load_config
from marl_clean.errors import BadInput
from marl_clean.evaluation.records import Entry
from marl_clean.evaluation.table import interval, output, percent

IGNORED_KEYS = (*OUTSIDE_THE_HASH, "seed")  # runs of one setting may differ in these
CAPTION = (
    "Rows: trained over; columns: measured over, on the same houses. T_90 with 95 % interval over\n"
    "seeds and houses (a house not finished counts as its max_steps), and houses finished."
)
log = logging.getLogger(__name__)


@dataclass
class Trained:
    """Runs that differ in their seed alone."""

    config: dict[str, Any]
    folders: list[Path] = field(default_factory=list)


def main(
    runs: Sequence[str],
    channels: Sequence[str] = (),
    houses: int | None = None,
    out: Path | None = None,
    console: Console | None = None,
) -> list[Entry]:
    """Measure every run over every channel; print the matrix and draw it to runs/figures/matrix.

    `channels` are stacks such as `lossy,quantised`, with settings as in `lossy(loss=0.5)`; without
    any, those that the runs were trained over. `houses`: their number, instead of each run's.
    `out`: where the entries are written, with policies named `TRAINED | MEASURED`.
    Raises BadInput where no run is left, or a channel is invalid.
    """
    groups = gather(runs)
    tested = {text: section_of(text) for text in channels} or trained_over(groups)
    for trained in groups.values():
        for section in tested.values():
            over(trained.config, section, houses)  # all are checked before any is measured
    from marl_clean import build
    from marl_clean.commands.compare import pooled
    from marl_clean.evaluation.evaluator import in_any_env, measure
    from marl_clean.evaluation.interventions import communicating
    from marl_clean.evaluation.records import write_entries
    from marl_clean.report.axes import save_figure
    from marl_clean.report.matrix import draw_matrix
    from marl_clean.report.origin import Origin

    console = console or output()
    cells: dict[tuple[str, str], Entry] = {}
    hashes = []
    for label, trained in groups.items():
        for name, section in tested.items():
            entries = []
            for folder in trained.folders:
                cfg = over(load_config(folder), section, houses)
                policy = communicating(build.load_policy(folder, cfg).to(cfg.device), cfg.name)
                epsilon = cfg.evaluation.epsilon
                title = f"{label} | {name}"
                entries.append(measure(cfg, partial(in_any_env, policy), title, epsilon=epsilon))
            hashes += [entry["config_hash"] for entry in entries]
            cells[label, name] = pooled(entries, f"{label} | {name}")
    console.print(make_matrix(cells))
    origin = Origin(command_line(), hashes)
    for path in save_figure(draw_matrix(cells), RUNS / "figures" / "matrix", origin):
        console.print(f"written to {path}", soft_wrap=True)
    if out is not None:
        write_entries(out, list(cells.values()))
    return list(cells.values())


def gather(runs: Sequence[str]) -> dict[str, Trained]:
    """The runs by their setting, seeds together; folders without a run are logged."""
    groups: dict[str, Trained] = {}
    for run in dict.fromkeys(runs):
        try:
            folder = find_run(run)
            config = load_config(folder)
        except BadInput as error:
            log.warning("left out: %s", error)
            continue
        setting = {key: value for key, value in config.items() if key not in IGNORED_KEYS}
        groups.setdefault(str(sorted(setting.items())), Trained(config)).folders.append(folder)
    if not groups:
        raise BadInput(f"matrix: no run among {', '.join(runs)}; give folders of {RUNS}/")
    names = labels([trained.config for trained in groups.values()], IGNORED_KEYS)
    return dict(zip(names, groups.values(), strict=True))


def trained_over(groups: Mapping[str, Trained]) -> dict[str, DictConfig]:
    """The distinct channels of the runs, labelled by what sets them apart."""
    sections: list[dict[str, Any]] = []
    for trained in groups.values():
        section = trained.config["channel"]
        if list(section.items()) not in [list(known.items()) for known in sections]:  # in order
            sections.append(section)
    names = labels([{"channel": section} for section in sections], ())
    names = [name.removeprefix("channel=") for name in names]
    if len(sections) == 1:
        names = ["+".join(sections[0])]
    return {name: OmegaConf.create(s) for name, s in zip(names, sections, strict=True)}


def section_of(text: str) -> DictConfig:
    """The channel section of `lossy(loss=0.5),quantised`. Raises BadInput for an invalid one."""
    stack, settings = [], []
    for part in text.replace(")", "").split(","):
        name, opened, inner = part.partition("(")
        if opened or "=" not in name:
            stack.append(name.strip())
            settings += [f"channel.{stack[-1]}.{inner}"] if inner else []
        else:  # a further setting of the previous channel
            settings.append(f"channel.{stack[-1]}.{name.strip()}")
    return compose_config([f"channel=[{','.join(stack)}]", *settings]).channel


def over(config: dict[str, Any], channel: DictConfig, houses: int | None) -> DictConfig:
    """A run's config over another channel, on its test houses."""
    changed = {**config, "channel": OmegaConf.to_container(channel)}
    changed["evaluation"] = {**config["evaluation"], "house_set": "test"}
    if houses is not None:
        changed["evaluation"]["houses"] = houses
    measured = checked(changed)
    check_all(measured)
    return measured


def make_matrix(cells: Mapping[tuple[str, str], Entry]) -> Table:
    """The matrix as a table in the terminal."""
    first = next(iter(cells.values()))
    table = Table(
        title=f"{first['house_set']}, {first['n_agents']} robots",
        caption=CAPTION,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("trained over", no_wrap=True)
    columns = list(dict.fromkeys(column for _, column in cells))
    for column in columns:
        table.add_column(column, justify="right")
    for row in dict.fromkeys(row for row, _ in cells):
        summaries = [cells[row, column]["summary"] for column in columns]
        table.add_row(
            row, *(f"{interval(s['T_90'])}\n{percent(s['T_100']['reached'])}" for s in summaries)
        )
    return table
