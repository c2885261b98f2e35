"""`marl-clean figure NAME`: one figure into runs/figures, as svg and png."""

from pathlib import Path

from omegaconf import DictConfig
from rich.console import Console

from marl_clean.commands.checks import check_square_view
from marl_clean.commands.command_line import command_line
from marl_clean.commands.comparison import COMPARISONS
from marl_clean.config.config_hash import config_hash
from marl_clean.config.schema import choices
from marl_clean.config.stored import RUNS
from marl_clean.errors import BadInput

# Known without importing the code that draws them.
NAMES = ("houses", "paper_1", "paper_2", "paper_3", "paper_4")


def main(name: str, cfg: DictConfig, console: Console | None = None) -> list[Path]:
    """Draw figure `name` of `cfg`'s world.

    Raises BadInput when there is no such figure, or it needs another observation.
    """
    if name not in NAMES:
        raise BadInput(f"figure {name!r}: no such figure; {choices(name, (*NAMES, *COMPARISONS))}")
    if name == "paper_2":
        check_square_view(cfg, "figure paper_2")
    from marl_clean.commands._plan_lines import write_plan_lines
    from marl_clean.report.axes import save_figure
    from marl_clean.report.figures import draw_figure
    from marl_clean.report.origin import Origin

    write_plan_lines(cfg)
    origin = Origin(command_line(), [config_hash(cfg)])
    paths = save_figure(draw_figure(name, cfg), RUNS / "figures" / name, origin)
    for path in paths:
        (console or Console()).print(f"written to {path}", soft_wrap=True)
    return paths
