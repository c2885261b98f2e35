"""IC3Net: a robot decides whether it speaks at all."""

from typing import final

from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm._gates import open_or_shut
from marl_clean.comm._hidden_states import HiddenStates, State, all_others
from marl_clean.comm.base import Hearing, NoisyWhileLearning, Width, outgoing
from marl_clean.settings import LayerWidth, PositiveFloat, PositiveInt


class Gate(NoisyWhileLearning):
    """Decide between 0 and 1 by a linear layer, see `open_or_shut`."""

    def __init__(self, width: int, temperature: float) -> None:
        super().__init__()
        self.logit = nn.Linear(width, 1)
        self.temperature = temperature

    def forward(self, hidden: Float[Tensor, "*batch hidden"]) -> Float[Tensor, "*batch 1"]:
        return open_or_shut(self.logit(hidden), self.temperature, self.training)


@final
class Ic3Net(HiddenStates):
    """Hear the sum of what others choose to send, over how many others there are.

        x_i = W_x feature_i,    h_i = tanh(x_i),    g_i = gate(h_i), 0 or 1, once a step
        each round: h'_i = tanh(x_i + F h_i + C sum over live edges of g_j [h_j, e_ij] / (n - 1))

    e_ij says where j is, with `places`, and is left out without. Silence dilutes: the divisor is
    all other robots, so the result depends on how many there are, also out of reach. A silent robot
    pays nothing. The gate learns by straight-through Gumbel from the receivers' losses, also where
    it is shut.

    Source: arXiv 1812.09755, a value-based port: there the gate is an action of policy gradients,
    it takes effect a step later, and a robot remembers by an LSTM (here `encoder.memory`).

    Args:
        in_features: length of the encoder's features.
        hidden: width of the hidden state, and so floats in a message.
        rounds: messages a step; each is paid for.
        temperature: of the gate's gradient; lower is nearer to a step, and steeper.
        detach: a receiver's loss does not reach the sender's hidden state, only the gate's weights.
        hearing: `places`, `join`: see `marl_clean.comm.base.Hearing`.
    """

    dilutes = True

    def __init__(
        self,
        in_features: Width,
        hidden: LayerWidth,
        rounds: PositiveInt,
        temperature: PositiveFloat,
        detach: bool,
        hearing: Hearing = Hearing(),
    ) -> None:
        super().__init__(in_features, hidden, rounds, detach, hearing)
        self.speaks = Gate(hidden, temperature)

    def divisor(self, live: Bool[Tensor, "*batch agent other"]) -> int:
        return all_others(live)

    def begin(self, feature: Float[Tensor, "*batch agent feature"]) -> State:
        skip, hidden = super().begin(feature)
        return skip, hidden, self.speaks(outgoing(hidden, self.detach))

    def gate(self, state: State, round_index: int) -> Float[Tensor, "*batch agent 1"]:
        return state[2]
