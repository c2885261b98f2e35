"""Losses that ground messages: what a message says has to be in the sender's map."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float, Int8
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.nn import functional

from marl_clean import keys
from marl_clean.comm._decoding import Decoding
from marl_clean.comm.base import PLACE, Comm, Senders, Talk, with_places
from marl_clean.env.known_cells import NOT_ASKED
from marl_clean.learning.acting import entries
from marl_clean.learning.networks import RobotsNetwork
from marl_clean.learning.representing import Reconstruction
from marl_clean.world.patches import NUM_CLASSES, SIDE

HIDDEN = 128
GROUNDING = "grounding"  # as states of runs in progress name it


class Grounding(nn.Module):
    """Decoders of messages, in learning alone, and their losses.

        sender_map: -log p(cell of j's map | m_j), mean over the 7 x 7 cells around each sender j
        missing:    -log p(cell of j's map | m_j, e_ij), mean over those of the 7 x 7 cells around
                    each receiver i that i does not know itself
        p: softmax over unknown, blocked, never cleaned, cleaned, by a layer of 128 ReLUs
        reconstruct: what robots see, of what schemes represent that do: see `Reconstruction`

    m_j is the message as it was sent, all rounds side by side, before any channel; e_ij says where
    j is, seen from i. Only messages count that are sent over an edge. Gradients reach message and
    sender, its features only where the scheme does not detach these (`comm.detach`).

    Source: our losses; after the reconstruction of arXiv 2110.15349.
    """

    def __init__(self, comm: Comm) -> None:
        super().__init__()
        self.weights = {"sender_map": comm.ground.sender_map, "missing": comm.ground.missing}
        if comm.represents and comm.reconstruct:
            self.weights["reconstruct"] = comm.reconstruct
        self.reconstruction = Reconstruction(comm) if "reconstruct" in self.weights else None
        numbers = sum(comm.message_dims[: comm.rounds])
        sizes = {"sender_map": numbers, "missing": numbers + PLACE}
        self.decoders = nn.ModuleDict(
            {name: _decoder(size) for name, size in sizes.items() if self.weights[name]}
        )

    @property
    def sees(self) -> Sequence[NestedKey]:
        """The entries of a frame that the losses take, beside those that the network does."""
        known = (keys.KNOWN,) if "sender_map" in self.decoders else ()
        missing = (keys.OFFSET, keys.MISSING) if "missing" in self.decoders else ()
        return (*known, *missing)

    def losses(self, talk: Talk, frames: TensorDictBase) -> dict[str, Tensor]:
        """Return the losses of what was sent in these frames, by name and without weights."""
        sends = talk.edges.sum(-1) > 0
        losses = {}
        if "sender_map" in self.decoders:
            asked = sends[..., None, None].expand(frames[keys.KNOWN].shape)
            decoded = self.decoders["sender_map"](talk.message)
            losses["sender_map"] = _surprise(decoded, frames[keys.KNOWN], asked)
        if "missing" in self.decoders:
            target, live = frames[keys.MISSING], frames[keys.ADJACENCY] & sends.unsqueeze(-2)
            asked = live[..., None, None] & (target != NOT_ASKED)
            offset = torch.where(live.unsqueeze(-1), frames[keys.OFFSET], 0)
            senders = Senders(frames[keys.DISTANCE_RANK], offset.to(talk.message.dtype))
            decoded = self.decoders["missing"](with_places(talk.message, senders))
            losses["missing"] = _surprise(decoded, target, asked)
        if self.reconstruction is not None:
            losses["reconstruct"] = self.reconstruction(talk.represented, frames)
        return losses

    def weighted(self, losses: dict[str, Tensor]) -> Tensor | float:
        """Return what is to be made small."""
        return sum((self.weights[name] * loss for name, loss in losses.items()), 0.0)


def grounding_of(comm: Comm, device: torch.device | str) -> Grounding | None:
    """Return the losses that the scheme and its `ground` ask for; None: none."""
    reconstructs = comm.represents and comm.reconstruct
    asked = comm.ground.sender_map or comm.ground.missing or reconstructs
    return Grounding(comm).to(device) if asked and comm.rounds else None


def ground_loss(
    grounding: Grounding | None, network: RobotsNetwork, frames: TensorDictBase
) -> tuple[Tensor | float, dict[str, Tensor]]:
    """Return the weighted sum of the losses, and each for the log; 0 and none without grounding.

    In frames in a row messages are made as the network carries what it remembers. Of a scheme
    whose receivers decode messages it is the loss of its code, whatever is sent.
    """
    comm = network.comm
    if isinstance(comm, Decoding):
        loss = comm.code_loss(frames[keys.AGENTS, comm.reads])
        return comm.reconstruct * loss, {"ground_code": loss.detach()}
    if grounding is None:
        return 0.0, {}
    begins = frames[keys.IS_INIT] if network.unrolls else None
    losses = grounding.losses(network.talks(entries(network, frames), begins), frames)
    measures = {f"ground_{name}": loss.detach() for name, loss in losses.items()}
    return grounding.weighted(losses), measures


def state_of(grounding: Grounding | None) -> dict[str, Any]:
    """Return the decoders' weights as a part of a learner's state."""
    return {} if grounding is None else {GROUNDING: grounding.state_dict()}


def load_state_of(grounding: Grounding | None, state: dict[str, Any]) -> None:
    """Take the decoders' weights from a learner's state, in place."""
    if grounding is not None:
        grounding.load_state_dict(state[GROUNDING])


def _decoder(numbers: int) -> nn.Sequential:
    cells = SIDE**2
    return nn.Sequential(
        nn.Linear(numbers, HIDDEN),
        nn.ReLU(),
        nn.Linear(HIDDEN, cells * NUM_CLASSES),
        nn.Unflatten(-1, (SIDE, SIDE, NUM_CLASSES)),
    )


def _surprise(
    logits: Float[Tensor, "*batch row col class"],
    target: Int8[Tensor, "*batch row col"],
    asked: Bool[Tensor, "*batch row col"],
) -> Float[Tensor, ""]:
    """Return -log p, mean over the cells that are asked for; 0 without any."""
    known = torch.where(asked, target, 0).to(torch.int64)
    surprise = functional.cross_entropy(logits.flatten(0, -2), known.flatten(), reduction="none")
    return torch.where(asked.flatten(), surprise, 0.0).sum() / asked.sum().clamp(min=1)
