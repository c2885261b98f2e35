"""What the encoders share."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn

from marl_clean.errors import BadInput
from marl_clean.settings import Norm, Recurrence


class Encoder(nn.Module, ABC):
    """Turns what each robot sees into a feature vector, and may remember features seen before.

    Attributes:
        observation_shape: of one robot's observation, without batch.
        out_features: length of a feature vector.
        memory: a GRU cell (arXiv 1406.1078) whose hidden state is the feature, carried from step
            to step by who runs the network; None: a robot remembers nothing but the map.
    """

    observation_shape: tuple[int, ...]
    out_features: int
    memory: nn.GRUCell | None

    @abstractmethod
    def forward(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch agent feature"]:
        """Return one feature vector a robot, from its own observation alone."""

    def check_shape(self, observation: Float[Tensor, "..."]) -> None:
        """Raises BadInput where robots are shown something of another shape than it is for."""
        shown = observation.shape[-len(self.observation_shape) :]
        if shown != self.observation_shape:
            raise BadInput(
                f"observation: the policy sees {list(self.observation_shape)} of a robot, this env"
                f" shows {list(shown)}; play in marl_clean.make_env(checkpoint=RUN)"
            )

    def remember(self, memory: Recurrence) -> None:
        """Add the memory that a setting asks for, as wide as the features."""
        width = self.out_features
        self.memory = nn.GRUCell(width, width) if memory == "gru" else None


def connect(widths: Sequence[int], dropout: float, norm: Norm = "none") -> nn.Sequential:
    """Return fully connected layers from widths[0] to widths[-1].

    Each is followed by a ReLU and, if asked for, dropout; with `norm=layer` by a LayerNorm before
    the ReLU (arXiv 1607.06450).
    """
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers.append(nn.Linear(before, after))
        layers += [nn.LayerNorm(after)] if norm == "layer" else []
        layers.append(nn.ReLU(inplace=True))
        layers += [nn.Dropout(dropout)] if dropout else []
    return nn.Sequential(*layers)
