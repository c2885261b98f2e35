"""An autoencoder's message: a code of the cells around the sender, read into the hearer's map."""

from typing import ClassVar, final

import torch
from jaxtyping import Bool, Float, Int8
from torch import Tensor, nn
from torch.nn import functional

from marl_clean.comm._decoding import Decoding
from marl_clean.comm.base import Scene, Senders, Width
from marl_clean.settings import LayerWidth, PositiveFloat, PositiveShare
from marl_clean.world.patches import NUM_CLASSES, SIDE, UNKNOWN

CELLS = SIDE**2


@final
class Autoencoder(Decoding):
    """Robots send a learnt binary code of what lies around them; hearers write what they read.

        m_j = sign(W_0 x_j + W_2 relu(W_1 x_j))    x_j: the 7 x 7 cells around j by its own map,
                                                   one-hot of unknown, blocked, never cleaned,
                                                   cleaned
        p(cell | m_j) = softmax(V_0 m_j + V_2 relu(V_1 m_j))
        loss: `reconstruct` x -log p(cell), mean over the cells of all robots

    The sign has the gradient of the hyperbolic tangent. A cell is written where p of one class
    is at least `sure`: into what the hearer has heard, which it sees where its own map is blank, as
    `marl_clean.world.patches` says, before it observes the next step. So what is said comes before
    the search for what to clean, and lasts; the features are returned unchanged. The code is learnt
    from what robots see, whatever they are paid, and where cells lie from where the sender is,
    which robots in contact see. A message of zeros tells nothing.

    Needs `env.memory=private`, and channels over which a message is heard in the step it is sent.

    Source: ours; autoencoded messages after arXiv 2110.15349, the gradient of the sign after
    arXiv 1308.3432.

    Args:
        in_features: length of the encoder's features.
        message_dim: bits of a message.
        hidden: width of the hidden layers.
        sure: least probability at which a cell is written.
        reconstruct: weight of the loss.
    """

    reads_numbers: ClassVar[int] = CELLS
    fits: ClassVar[dict[str, list[str]]] = {
        "env": ["cleaning"],
        "channel": ["perfect", "lossy", "noisy", "quantised", "budget", "constant", "self_send"],
    }
    bits_per_number = 1

    def __init__(
        self,
        in_features: Width,
        message_dim: LayerWidth,
        hidden: LayerWidth,
        sure: PositiveShare,
        reconstruct: PositiveFloat,
    ) -> None:
        super().__init__()
        self.message_dims, self.out_features = (message_dim,), in_features
        self.sure, self.reconstruct = sure, reconstruct
        self.encoder = _Layers(CELLS * NUM_CLASSES, hidden, message_dim)
        self.decoder = _Layers(message_dim, hidden, CELLS * NUM_CLASSES)

    def look(
        self, feature: Float[Tensor, "*batch agent feature"], scene: Scene
    ) -> tuple[Float[Tensor, "*batch agent feature"], Float[Tensor, "*batch agent message"]]:
        assert scene.read is not None
        return feature, self.code(scene.read)

    def speak(
        self, state: tuple[Tensor, Tensor], round_index: int
    ) -> Float[Tensor, "*batch agent message"]:
        return state[1]

    def listen(
        self,
        state: tuple[Tensor, Tensor],
        heard: Float[Tensor, "*batch agent message"],
        live: Bool[Tensor, "*batch agent other"],
        senders: Senders,
        round_index: int,
    ) -> tuple[Tensor, Tensor]:
        return state

    def end(self, state: tuple[Tensor, Tensor]) -> Float[Tensor, "*batch agent feature"]:
        return state[0]

    def code(
        self, patch: Int8[Tensor, "*batch agent cell"]
    ) -> Float[Tensor, "*batch agent message"]:
        """Return the message of each robot, of numbers -1 and 1."""
        kinds = functional.one_hot(patch.long(), NUM_CLASSES).to(self.encoder.direct.weight.dtype)
        number = self.encoder(kinds.flatten(-2)).tanh()
        return number + (torch.where(number < 0, -1.0, 1.0) - number).detach()

    def decode(
        self, heard: Float[Tensor, "*batch agent message"]
    ) -> Float[Tensor, "*batch agent class cell"]:
        """Return the logits of what each sender's cells are.

        Classes before cells: over a last dimension of 4 the loss took four times as long.
        """
        return self.decoder(heard).unflatten(-1, (NUM_CLASSES, CELLS))

    def code_loss(self, read: Int8[Tensor, "*batch agent cell"]) -> Float[Tensor, ""]:
        logits = self.decode(self.code(read))
        return functional.cross_entropy(logits.flatten(0, -3), read.long().flatten(0, -2))

    def patch_of(
        self, heard: Float[Tensor, "*batch agent message"]
    ) -> Int8[Tensor, "*batch agent cell"]:
        share, kind = self.decode(heard).softmax(-2).max(-2)
        is_told = (share >= self.sure) & heard.ne(0).any(-1, keepdim=True)
        return torch.where(is_told, kind, UNKNOWN).to(torch.int8)


class _Layers(nn.Module):
    """A hidden layer of ReLUs, and what it adds to a linear map: that alone learns much sooner."""

    def __init__(self, before: int, hidden: int, after: int) -> None:
        super().__init__()
        self.direct = nn.Linear(before, after)
        self.hidden = nn.Sequential(
            nn.Linear(before, hidden), nn.ReLU(), nn.Linear(hidden, after, bias=False)
        )

    def forward(self, x: Float[Tensor, "*batch before"]) -> Float[Tensor, "*batch after"]:
        return self.direct(x) + self.hidden(x)
