"""The scheme that channels are tested with, and the steps in which it talks."""

from typing import NamedTuple, final

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from marl_clean.comm.base import Comm, Senders, sum_live
from marl_clean.testing._graphs import FEATURES, draw


@final
class Talkers(Comm):
    """The scheme that channels are tested with: it sums what it hears, one round for each width.

    m_j = M h_j,    h'_i = tanh(A h_i + B sum over live edges of m_j), or of g m_j with a gate g
    """

    def __init__(self, widths: tuple[int, ...], gate: float | None = None) -> None:
        super().__init__()
        with torch.random.fork_rng([]):
            torch.manual_seed(0)
            self.message = nn.ModuleList(nn.Linear(FEATURES, width) for width in widths)
            self.own = nn.ModuleList(nn.Linear(FEATURES, FEATURES) for _ in widths)
            self.others = nn.ModuleList(nn.Linear(width, FEATURES) for width in widths)
        self.message_dims, self.out_features = widths, FEATURES
        self.open = gate
        self.double().eval()

    @property
    def gated(self) -> bool:
        return self.open is not None

    def speak(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return self.message[round_index](state)

    def gate(
        self, state: Float[Tensor, "*batch agent feature"], round_index: int
    ) -> Float[Tensor, "*batch agent 1"] | None:
        return None if self.open is None else torch.full_like(state[..., :1], self.open)

    def listen(
        self,
        state: Float[Tensor, "*batch agent feature"],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> Float[Tensor, "*batch agent feature"]:
        others = self.others[round_index](sum_live(heard, live))
        return (self.own[round_index](state) + others).tanh()


class Frames(NamedTuple):
    """Steps in a row: features, live edges, ranks by distance, and draws for the channels."""

    feature: Tensor
    live: Tensor
    rank: Tensor
    seed: Tensor


def drawn_frames(
    steps: int, *batch: int, n_agents: int, share: float = 0.5, seed: int = 0
) -> Frames:
    """Return features and a graph that change from step to step."""
    generator = torch.Generator().manual_seed(seed)
    drawn = torch.randint(2**32, (steps, *batch, n_agents), generator=generator)
    feature, live, senders = draw(steps, *batch, n_agents=n_agents, share=share, seed=seed)
    return Frames(feature, live, senders.distance_rank, drawn)
