"""The figures that `marl-clean figure NAME` draws, each from live objects of the config."""

from collections.abc import Callable
from itertools import islice

import matplotlib
import numpy as np
import torch
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from omegaconf import DictConfig
from tensordict import TensorDictBase

from marl_clean import build
from marl_clean.config.schema import instantiate
from marl_clean.config.stored import find_run
from marl_clean.env.scene import scene_of
from marl_clean.env.viewer import (
    BLOCKED,
    DIRTY,
    FURNITURE,
    INK,
    PAGE,
    WALL,
    Colour,
    Scene,
    robot_colour,
)
from marl_clean.house.base import Houses
from marl_clean.keys import OBSERVATION
from marl_clean.report.axes import STYLE, draw_cells, draw_robots, new_figure, unit
from marl_clean.report.episode import first_held_out, policy_of, rollout
from marl_clean.report.floor_plan import draw_floor_plan
from marl_clean.report.network import Layer, draw_single, draw_together, watch_layers
from marl_clean.world.rules import UNKNOWN_VALUE

SHEET_ROWS, SHEET_COLS = 4, 8
MEMORY_STEPS = 18  # far enough to show all three kinds of cells in the smallest houses
# Figure 2 of the paper: "the darker grey ... unknown, black represents obstacles and lighter
# gray represents visited area".
PAPER_UNKNOWN: Colour = (112, 116, 122)
PAPER_VISITED: Colour = (214, 216, 219)


def draw_figure(name: str, cfg: DictConfig) -> Figure:
    """Draw one of FIGURES."""
    with matplotlib.rc_context(STYLE):
        return FIGURES[name](cfg)


def paper_1(cfg: DictConfig) -> Figure:
    """Two possible houses from above (paper figure 1)."""
    figure = new_figure(6.0, 3.2)
    houses = build.held_out_houses(cfg, cfg.evaluation.house_set, 2)
    for index, axes in enumerate(figure.subplots(1, 2)):
        house = index % len(houses)
        draw_cells(axes, house_colours(houses, house))
        axes.set_title(house_title(houses, house))
    return figure


def houses(cfg: DictConfig) -> Figure:
    """A sheet of held-out houses with their seeds and numbers of free cells, or one floor plan."""
    house = instantiate(cfg.house)
    if not house.generated:
        return draw_floor_plan(house.layout(0))
    figure = new_figure(1.45 * SHEET_COLS, 1.65 * SHEET_ROWS)
    drawn = build.held_out_houses(cfg, cfg.evaluation.house_set, SHEET_ROWS * SHEET_COLS)
    for index, axes in enumerate(figure.subplots(SHEET_ROWS, SHEET_COLS).flat):
        if index < len(drawn):
            draw_cells(axes, house_colours(drawn, index))
            axes.set_title(house_title(drawn, index), fontsize=6)
        else:
            axes.set_axis_off()
    return figure


def paper_2(cfg: DictConfig) -> Figure:
    """The robots' memory, and the square of it that robot 1 sees (paper figure 2)."""
    env = first_held_out(cfg)
    *_, moment = islice(rollout(env, policy_of(cfg)), MEMORY_STEPS + 1)
    view = moment[OBSERVATION][0, 0, 0].cpu().numpy()
    scene = scene_of(env.base_env.state, env.base_env.rules, 0)
    figure = new_figure(7.4, 3.9)
    memory_axes, view_axes = figure.subplots(1, 2)
    _draw_memory(memory_axes, scene, len(view))
    _draw_view(view_axes, view)
    return figure


def paper_3(cfg: DictConfig) -> Figure:
    """One robot's network, from what it sees to four Q-values (paper figure 3)."""
    return draw_single(*_watched(cfg))


def paper_4(cfg: DictConfig) -> Figure:
    """Robot 1's network with what the other robots send it (paper figure 4)."""
    return draw_together(*_watched(cfg))


def _watched(cfg: DictConfig) -> tuple[list[Layer], TensorDictBase]:
    """The layers of a run's network, or of an untrained network, at the moment of figure 2."""
    env = first_held_out(cfg)
    if cfg.checkpoint is not None:
        policy = build.load_policy(find_run(cfg.checkpoint), cfg).to(cfg.device)
    else:
        torch.manual_seed(cfg.seed)
        policy = build.make_agent(cfg, env).policy()
    *_, moment = islice(rollout(env, policy_of(cfg)), MEMORY_STEPS + 1)
    return watch_layers(policy, moment)


FIGURES: dict[str, Callable[[DictConfig], Figure]] = {
    "houses": houses,
    "paper_1": paper_1,
    "paper_2": paper_2,
    "paper_3": paper_3,
    "paper_4": paper_4,
}


def house_colours(houses: Houses, index: int) -> UInt8[np.ndarray, "row col 3"]:
    """One house of a stack from above, without its padding."""
    inside = slice(int(houses.rows[index])), slice(int(houses.cols[index]))
    free, furniture = houses.free[index][inside], houses.furniture[index][inside]
    colours = np.empty((*free.shape, 3), dtype=np.uint8)
    colours[:] = WALL
    colours[furniture > 0] = FURNITURE
    colours[free] = DIRTY
    return colours


def house_title(houses: Houses, index: int) -> str:
    """A house's seed or path, and its number of free cells."""
    source = houses.sources[index]
    origin = f"seed {source}" if isinstance(source, int) else str(source)
    return f"{origin}: {houses.free_cells[index]} cells"


def memory_colours(values: Float[np.ndarray, "row col"]) -> UInt8[np.ndarray, "row col 3"]:
    """The map in the paper's greys."""
    colours = np.empty((*values.shape, 3), dtype=np.uint8)
    colours[:] = PAPER_VISITED
    colours[values < 0] = PAPER_UNKNOWN
    colours[values <= -1] = BLOCKED
    return colours


def _draw_memory(axes: Axes, scene: Scene, view_size: int) -> None:
    """The whole map with robot 1's square in it; cells outside the house are unknown too."""
    corner = tuple(place - view_size // 2 for place in scene.positions[0])
    before = [max(0, -start) for start in corner]
    after = [
        max(0, start + view_size - side)
        for start, side in zip(corner, scene.values.shape, strict=True)
    ]
    values = np.pad(
        scene.values, list(zip(before, after, strict=True)), constant_values=UNKNOWN_VALUE
    )
    draw_cells(axes, memory_colours(values))
    draw_robots(axes, [(row + before[0], col + before[1]) for row, col in scene.positions])
    row, col = (start + shift for start, shift in zip(corner, before, strict=True))
    square = matplotlib.patches.Rectangle((col, row), view_size, view_size, clip_on=False)
    square.set(fill=False, edgecolor=unit(robot_colour(0)), linewidth=1.5, zorder=5)
    # Robot 1's colour is as light as what is unknown around its square.
    square.set_path_effects([withStroke(linewidth=4, foreground=unit(PAGE))])
    axes.add_patch(square)
    axes.set_title(f"the robots' memory after {scene.step} steps")


def _draw_view(axes: Axes, view: Float[np.ndarray, "row col"]) -> None:
    """The network's input: the square in its colours, with its values as digits."""
    draw_cells(axes, memory_colours(view))
    size = min(6.0, 70 / len(view))
    for (row, col), value in np.ndenumerate(view):
        colour = PAGE if value < 0 else INK
        axes.text(
            col + 0.5, row + 0.5, digits(float(value)),
            color=unit(colour), fontsize=size, ha="center", va="center",
        )  # fmt: skip
    axes.set_title("what robot 1 sees, itself in the middle")


def digits(value: float) -> str:
    """A map value in as few characters as possible: -1, -.2, .45, 1."""
    short = f"{value:.2f}".rstrip("0").rstrip(".")
    return short.replace("0.", ".") if short not in ("0", "-0") else "0"
