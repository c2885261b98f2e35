"""The base class of encoders, and the layers they share."""

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
            to step by the caller; None: a robot remembers only the map.
    """

    observation_shape: tuple[int, ...]
    out_features: int
    memory: nn.GRUCell | None

    @abstractmethod
    def forward(self, observation: Float[Tensor, "..."]) -> Float[Tensor, "*batch agent feature"]:
        """Return one feature vector a robot, from its own observation alone."""

    def check_shape(self, observation: Float[Tensor, "..."]) -> None:
        """Raises BadInput where observations have another shape than the encoder was built for."""
        shown = observation.shape[-len(self.observation_shape) :]
        if shown != self.observation_shape:
            raise BadInput(
                f"observation: the policy sees {list(self.observation_shape)} of a robot, this env"
                f" shows {list(shown)}; use marl_clean.make_env(checkpoint=RUN)"
            )

    def remember(self, memory: Recurrence) -> None:
        """Add the memory of the setting `memory`, as wide as the features."""
        width = self.out_features
        self.memory = nn.GRUCell(width, width) if memory == "gru" else None


def connect(widths: Sequence[int], dropout: float, norm: Norm = "none") -> nn.Sequential:
    """Return fully connected layers from widths[0] to widths[-1].

    Each is followed by a ReLU and, if `dropout` is not 0, dropout; with `norm=layer` a LayerNorm
    precedes the ReLU (arXiv 1607.06450).
    """
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers.append(nn.Linear(before, after))
        layers += [nn.LayerNorm(after)] if norm == "layer" else []
        layers.append(nn.ReLU(inplace=True))
        layers += [nn.Dropout(dropout)] if dropout else []
    return nn.Sequential(*layers)
