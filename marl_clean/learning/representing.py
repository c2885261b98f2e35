"""Losses that teach a scheme's representation of all that a robot heard."""

import torch
from jaxtyping import Bool, Float, Int
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn import functional

from marl_clean import keys
from marl_clean.comm._senders import PLACE
from marl_clean.comm.base import Comm, Senders, place_of
from marl_clean.learning.acting import entries
from marl_clean.learning.networks import RobotsNetwork

HIDDEN = 128
REPRESENTATION = "representation"  # as states of runs in progress name it


class Representation(nn.Module):
    """What a representation z is taught by, in learning alone.

        S_i: those in contact with i, and i itself
        reconstruct: |D([z_i, e_ij]) - o_j|^2 / numbers in o_j, mean over i and each j of S_i
        predict:     |z_i + F([z_i, mean over j of S_i of A a_j]) - z'_i|^2 / numbers in z_i, mean

    o_j is what j sees, a_j what it does. e_ij says where j is, with `comm.places`; without it D
    gives the mean of what they see. z'_i is the target network's, of the next frame, and constant;
    it lies n steps ahead with n-step windows, and a_j is the first of these steps'. D and F are
    layers of 128 ReLUs. In frames in a row gradients stay in their frame.

    Source: arXiv 2302.09605, without its rewards, projections and further steps; the first loss
    also arXiv 2502.19717. There the true state is reconstructed.
    """

    def __init__(self, comm: Comm, num_actions: int) -> None:
        super().__init__()
        self.weights = {"reconstruct": comm.reconstruct, "predict": comm.predict}
        self.places, self.num_actions = comm.places, num_actions
        width = comm.represents
        if comm.reconstruct:
            self.decoder = _layers(width + PLACE * comm.places, comm.observed)
        if comm.predict:
            self.done = nn.Linear(num_actions, width)
            self.model = _layers(2 * width, width)

    def reconstruct(
        self, represented: Float[Tensor, "*batch agent z"], frames: TensorDictBase
    ) -> Float[Tensor, ""]:
        """Return how far what is decoded is from what the robots see."""
        member = _members(frames[keys.ADJACENCY])
        seen = frames[keys.OBSERVATION].flatten(member.ndim - 1)
        asked = represented.unsqueeze(-2).expand(*member.shape, -1)
        if self.places:
            contact = frames[keys.ADJACENCY].unsqueeze(-1)
            offset = torch.where(contact, frames[keys.OFFSET], 0)
            place = place_of(Senders(frames[keys.DISTANCE_RANK], offset.to(asked.dtype)))
            asked = torch.cat([asked, place], dim=-1)
        missed = (self.decoder(asked) - seen.unsqueeze(-3)).square().mean(-1)
        return torch.where(member, missed, 0.0).sum() / member.sum()

    def foretell(
        self,
        represented: Float[Tensor, "*batch agent z"],
        action: Int[Tensor, "*batch agent"],
        adjacency: Bool[Tensor, "*batch agent other"],
    ) -> Float[Tensor, "*batch agent z"]:
        """Return what the representation will be."""
        member = _members(adjacency).to(represented.dtype)
        one_hot = functional.one_hot(action, self.num_actions).to(represented.dtype)
        done = member @ self.done(one_hot) / member.sum(-1, keepdim=True)
        return represented + self.model(torch.cat([represented, done], dim=-1))


def representation_of(comm: Comm, num_actions: int) -> Representation | None:
    """Return what the scheme's representation is taught by; None: by nothing."""
    taught = comm.represents and (comm.reconstruct or comm.predict)
    return Representation(comm, num_actions) if taught else None


def represent_loss(
    part: Representation, network: RobotsNetwork, target: RobotsNetwork, frames: TensorDictBase
) -> tuple[Tensor | float, dict[str, Tensor]]:
    """Return the weighted sum of the losses, and each for the log."""
    now = network(entries(network, frames)).talk.represented
    assert now is not None
    losses = {}
    if part.weights["reconstruct"]:
        losses["reconstruct"] = part.reconstruct(now, frames)
    if part.weights["predict"]:
        with torch.no_grad():
            then = target(entries(target, frames["next"])).talk.represented
        foretold = part.foretell(now, frames[keys.ACTION], frames[keys.ADJACENCY])
        losses["predict"] = functional.mse_loss(foretold, then)
    total = sum((part.weights[name] * loss for name, loss in losses.items()), 0.0)
    return total, {name: loss.detach() for name, loss in losses.items()}


def _members(adjacency: Bool[Tensor, "*batch agent other"]) -> Bool[Tensor, "*batch agent other"]:
    itself = torch.eye(adjacency.shape[-1], dtype=torch.bool, device=adjacency.device)
    return adjacency | itself


def _layers(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(before, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, after))
