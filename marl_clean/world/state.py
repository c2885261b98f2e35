"""What one batch of cleaning worlds consists of."""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass
class State:
    """All of a batch of worlds, as tensors; the only thing that changes during an episode.

    Matrices have `margin` cells around the house on every side (the first of them is the ring
    of walls), so that no view ever leaves them: house cell (row, col) lies at
    [row + margin, col + margin]. All integers are int64.
    """

    blocked: Bool[Tensor, "env height width"]  # the truth, everything outside the house too
    piece: Int[Tensor, "env height width"]  # int16: which piece of furniture blocks, 0 none
    house: Int[Tensor, " env"]  # index into the houses
    rows: Int[Tensor, " env"]
    cols: Int[Tensor, " env"]
    num_free: Int[Tensor, " env"]
    max_steps: Int[Tensor, " env"]
    furniture_moves: Int[Tensor, "env move 3"]  # (step, piece, direction), due during the episode

    episode: Int[Tensor, " env"]
    step: Int[Tensor, " env"]
    last_progress: Int[Tensor, " env"]  # step of the last first-time cleaning
    position: Int[Tensor, "env agent 2"]  # (row, col) in the house
    record: Float[Tensor, "env map height width"]  # the robots' memory, see shared_map
    visited: Bool[Tensor, "env height width"]  # free now and cleaned since it became free
    num_visited: Int[Tensor, " env"]

    moved: Bool[Tensor, "env agent"]  # what the last step brought
    bumped: Bool[Tensor, "env agent"]
    collided: Bool[Tensor, "env agent"]
    newly_cleaned: Bool[Tensor, "env agent"]

    # None without spills: an episode then holds, copies and saves nothing of them.
    spill_steps: Int[Tensor, "env spill"] | None = None  # at which one is due, 0 never
    spilt: Bool[Tensor, "env height width"] | None = None  # and not cleaned since
    num_spilt: Int[Tensor, " env"] | None = None  # cells, each as often as it was spilt
    num_open_spilt: Int[Tensor, " env"] | None = None  # cells of `spilt`

    # None without an exchange of map cells: an episode then holds and saves nothing of it.
    said: Float[Tensor, "env map height width"] | None = None  # what each map says, as compared
    changed_at: Int[Tensor, "env map height width"] | None = None  # int32: the step it last changed
    heard_from: Int[Tensor, "env map height width"] | None = None  # int8: a robot, -1 none
    told_until: Int[Tensor, "env agent agent"] | None = None  # [i, j]: how far j has told i
    exchanged_bits: Int[Tensor, "env agent"] | None = None  # that each robot sent last

    # None unless maps are lent or patches heard: what each robot itself has written, while `record`
    # shows more; and the last that it has heard of each cell.
    own_record: Float[Tensor, "env map height width"] | None = None
    heard_record: Float[Tensor, "env map height width"] | None = None

    @property
    def n_agents(self) -> int:
        return self.position.shape[1]

    def tensors(self) -> dict[str, Tensor]:
        """Return every field that is not None by name; the tensors themselves, not copies."""
        named = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in named.items() if value is not None}

    def rows_of(self, rows: Int[Tensor, " row"]) -> "State":
        """Return a copy of the worlds `rows`."""
        return State(**{name: tensor[rows] for name, tensor in self.tensors().items()})

    def write_rows_(self, rows: Int[Tensor, " row"], other: "State") -> None:
        """Overwrite the worlds `rows` by those of `other`: the matrices in place.

        What is one number a world or a robot gets a new tensor, since the old one may have been
        handed out as part of a recorded step.
        """
        for name, tensor in self.tensors().items():
            new = getattr(other, name)
            if name in MATRICES:
                tensor[rows] = new
            else:
                setattr(self, name, tensor.index_copy(0, rows, new))


MATRICES = (
    "blocked",
    "piece",
    "record",
    "visited",
    "spilt",
    "said",
    "changed_at",
    "heard_from",
    "own_record",
    "heard_record",
)


def cell_index(position: Tensor, margin: int, width: int) -> Tensor:
    """Flatten (row, col) places in the house to indices into a matrix [height * width]."""
    return (position[..., 0] + margin) * width + position[..., 1] + margin


def pad_house(matrix: Tensor, margin: int, value: bool | int) -> Tensor:
    """Put `margin` cells of `value` around matrices [..., row, col]."""
    return torch.nn.functional.pad(matrix, (margin,) * 4, value=value)
