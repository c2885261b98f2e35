"""Figures 3 and 4 of the paper: the network, drawn from its modules as they run.

Every layer with weights is hooked while the policy acts on one real frame, so the figure shows the
shapes and values of that forward pass, and which robots were in contact.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from tensordict import TensorDictBase
from torch import Tensor, nn

from marl_clean.env.viewer import INK, ROBOTS, robot_colour
from marl_clean.keys import ACTION_VALUE, ADJACENCY, JOINT_ACTION_VALUE, MESSAGE, OBSERVATION
from marl_clean.learning.joint_actions import decode_joint
from marl_clean.report.axes import new_figure, unit

STEP = 1.75  # from one layer to the next
LANE = 2.6  # from one robot to the next
SHADES = ((0.86, 0.89, 0.93), (0.93, 0.89, 0.82), (0.87, 0.92, 0.86))  # encoder, comm, head
ACTIONS = ("0 up", "1 right", "2 down", "3 left")


@dataclass(frozen=True)
class Layer:
    """One layer with weights, as it ran.

    Attributes:
        part: the part of the network that it belongs to: encoder, comm, join or head.
        label: its kind and size, in words.
        shape: its output's for one robot (or for all of them, where they are joined).
    """

    part: str
    label: str
    shape: tuple[int, ...]

    @property
    def is_image(self) -> bool:
        return len(self.shape) == 3


def watch_layers(policy: nn.Module, moment: TensorDictBase) -> tuple[list[Layer], TensorDictBase]:
    """Run a policy once; return its layers in the order they ran, and its output."""
    network: nn.Module = policy.network  # type: ignore[assignment]
    layers: list[Layer] = []

    def note(name: str) -> Callable[..., None]:
        def hook(module: nn.Module, inputs: tuple[Tensor, ...], result: Tensor) -> None:
            shape = result.shape[-3:] if isinstance(module, nn.Conv2d) else result.shape[-1:]
            layers.append(Layer(name.partition(".")[0], describe(name, module), tuple(shape)))

        return hook

    handles = [
        module.register_forward_hook(note(name))
        for name, module in network.named_modules()
        if isinstance(module, nn.Conv2d | nn.Linear)
    ]
    try:
        with torch.no_grad():
            output = policy(moment.clone())
    finally:
        for handle in handles:
            handle.remove()
    return layers, output


def describe(name: str, module: nn.Module) -> str:
    """A layer's label: its place in the network, kind and size."""
    if isinstance(module, nn.Conv2d):
        side, stride = module.kernel_size[0], module.stride[0]
        return f"conv {side}x{side}" + (f" / {stride}" if stride != 1 else "")
    block = [part for part in name.split(".")[1:] if not part.isdigit()]
    return f"{block[0]} FCL" if block and name.startswith("comm") else "FCL"


def draw_single(layers: Sequence[Layer], output: TensorDictBase) -> Figure:
    """One robot's state through convolutions and fully connected layers to Q-values (figure 3)."""
    own = [layer for layer in layers if not _is_communication(layer)]
    figure, axes = _canvas(len(own), lanes=1)
    end = _draw_lane(axes, 0, _state_of(output, 0), own)
    _draw_values(axes, end, 0, _values_of(output, 0))
    axes.set_title("from what a robot sees to the values of its actions", loc="left")
    return figure


def draw_together(layers: Sequence[Layer], output: TensorDictBase) -> Figure:
    """Robot 1's network together with what the others send it (figure 4); one lane per robot.

    An arrow from another robot's lane is solid where a message passes over it at this moment.
    """
    encoder = [layer for layer in layers if layer.part == "encoder"]
    sending = [layer for layer in layers if _is_communication(layer)]
    rest = [layer for layer in layers if layer not in encoder and layer not in sending]
    n_agents = output[OBSERVATION].shape[1]
    central = JOINT_ACTION_VALUE in output.keys(True)
    figure, axes = _canvas(len(encoder) + len(sending) + len(rest), lanes=n_agents)
    is_received = _is_received(output, central)
    after = 1 + len(encoder) + len(sending)
    meets = after + next(i for i, layer in enumerate(rest) if not layer.label.startswith("own"))
    for robot in range(n_agents):
        shown = encoder if robot == 0 else [*encoder, *sending]
        end = _draw_lane(axes, robot, _state_of(output, robot), shown)
        if robot > 0:
            _draw_arrow(axes, (end, -LANE * robot), (STEP * meets - 0.3, -0.7), is_received[robot])
    end = _draw_lane(axes, 0, None, rest, first=after)
    _draw_arrow(axes, (STEP * len(encoder) + 0.65, 0.0), (STEP * after - 0.5, 0.0), True)
    values = _joint_values_of(output) if central else _values_of(output, 0)
    _draw_values(axes, end, 0, values)
    if central:
        kind = "all states into one network"
    else:
        kind = f"messages of {output[MESSAGE].shape[-1]} floats"
    axes.set_title(f"{n_agents} robots, {kind}", loc="left")
    return figure


def _is_communication(layer: Layer) -> bool:
    """Whether a layer computes or processes messages, rather than the robot's own features."""
    return layer.part == "comm" and layer.label.split()[0] in ("message", "received")


def _canvas(layers: int, lanes: int) -> tuple[Figure, Axes]:
    width, height = STEP * (layers + 2.4), LANE * lanes
    figure = new_figure(0.62 * width, 0.75 * height + 0.5)
    axes = figure.subplots()
    axes.set(xlim=(-0.9, width - 0.9), ylim=(-height + LANE / 2 - 0.2, LANE / 2 + 0.2))
    axes.set_aspect("equal")
    axes.set_axis_off()
    return figure, axes


def _draw_lane(
    axes: Axes,
    robot: int,
    state: Float[np.ndarray, "..."] | None,
    layers: Sequence[Layer],
    first: int = 1,
) -> float:
    """Draw a robot's state, if given, and layers to the right of it; return where they end."""
    row = -LANE * robot
    if state is not None:
        _draw_state(axes, row, robot, state)
    largest = max((layer.shape[-1] for layer in layers if layer.is_image), default=1)
    for index, layer in enumerate(layers, start=first):
        _draw_layer(axes, STEP * index, row, layer, largest)
        if state is not None or index > first:
            _draw_arrow(axes, (STEP * index - 0.85, row), (STEP * index - 0.5, row), True)
    return STEP * (first + len(layers) - 1) + 0.5


def _draw_state(axes: Axes, row: float, robot: int, state: Float[np.ndarray, "..."]) -> None:
    picture = state if state.ndim == 2 else state.reshape(1, -1)
    half = 0.6
    high = half if state.ndim == 2 else 0.12
    axes.imshow(
        picture,
        cmap="gray",
        vmin=-1,
        vmax=1,
        extent=(-half, half, row - high, row + high),
        zorder=2,
    )
    frame = Rectangle((-half, row - high), 2 * half, 2 * high)
    frame.set(fill=False, edgecolor=unit(robot_colour(robot)), linewidth=2, zorder=3)
    axes.add_patch(frame)
    shape = " x ".join(map(str, state.shape))
    _write(axes, 0.0, row - high - 0.22, f"state of robot {robot + 1}\n{shape}")


def _draw_layer(axes: Axes, col: float, row: float, layer: Layer, largest: int) -> None:
    """Stacked planes for a convolution, a bar for a fully connected layer."""
    shade = SHADES[{"encoder": 0, "head": 2}.get(layer.part, 1)]
    if layer.is_image:
        side = max(0.3, 0.95 * layer.shape[-1] / largest)
        for plane in range(4, -1, -1):
            shift = 0.06 * (plane - 2)
            _box(axes, col + shift, row + shift, side, side, shade)
        low = side / 2 + 0.12
    else:
        high = 0.25 + 0.13 * float(np.log2(layer.shape[0]))
        _box(axes, col, row, 0.3, high, shade)
        low = high / 2
    size = " x ".join(map(str, layer.shape))
    _write(axes, col, row - low - 0.22, f"{layer.label}\n{size}")


def _draw_values(axes: Axes, end: float, robot: int, values: dict[str, float]) -> None:
    best = max(values, key=lambda name: values[name])
    lines = [f"Q({name}) = {value:.2f}" for name, value in values.items()]
    places = np.linspace(0.6, -0.6, len(lines)) - LANE * robot
    for place, line, name in zip(places, lines, values, strict=True):
        weight = "bold" if name == best else "normal"
        colour = unit(ROBOTS[0] if name == best else INK)
        axes.text(end + 0.5, place, line, fontsize=7.5, va="center", weight=weight, color=colour)
    _draw_arrow(axes, (end - 0.1, -LANE * robot), (end + 0.4, -LANE * robot), True)


def _draw_arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], live: bool
) -> None:
    style = "-" if live else ":"
    arrow = FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=8, linestyle=style)
    arrow.set(color=unit(INK), linewidth=0.9, zorder=1)
    axes.add_patch(arrow)


def _box(axes: Axes, col: float, row: float, width: float, height: float, shade: tuple) -> None:
    box = Rectangle((col - width / 2, row - height / 2), width, height)
    box.set(facecolor=shade, edgecolor=unit(INK), linewidth=0.7, zorder=2)
    axes.add_patch(box)


def _write(axes: Axes, col: float, row: float, text: str) -> None:
    axes.text(col, row, text, fontsize=6.5, ha="center", va="top", color=unit(INK))


def _state_of(output: TensorDictBase, robot: int) -> Float[np.ndarray, "..."]:
    observation = output[OBSERVATION][0, robot].cpu().numpy()
    return observation[0] if observation.ndim == 3 else observation


def _values_of(output: TensorDictBase, robot: int) -> dict[str, float]:
    return dict(zip(ACTIONS, output[ACTION_VALUE][0, robot].tolist(), strict=True))


def _joint_values_of(output: TensorDictBase, most: int = 8) -> dict[str, float]:
    """The `most` best joint actions and their values."""
    values = output[JOINT_ACTION_VALUE][0]
    best = values.topk(min(most, len(values)))
    parts = decode_joint(best.indices, output[OBSERVATION].shape[1]).tolist()
    names = [" ".join(map(str, actions)) for actions in parts]
    return dict(zip(names, best.values.tolist(), strict=True))


def _is_received(output: TensorDictBase, central: bool) -> list[bool]:
    """Which robots' features or messages robot 1's part of the network receives now."""
    live = output[ADJACENCY][0, 0].tolist()
    if central:
        return [True] * len(live)
    return [edge and output[MESSAGE].shape[-1] > 0 for edge in live]
