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
PREDICTION = "prediction"  # as states of runs in progress name it


class Reconstruction(nn.Module):
    """What a representation z holds, in learning alone: what the robots see that it is made of.

        loss = |D([z_i, e_ij]) - o_j|^2 / numbers in o_j, mean over i and each j of S_i
        S_i: those in contact with i, and i itself

    o_j is what j sees. e_ij says where j is, with `comm.places`; without it D gives the mean of
    what they see. D is a layer of 128 ReLUs.

    Source: arXiv 2302.09605 and 2502.19717. There the true state is reconstructed, whose size here
    differs between houses.
    """

    def __init__(self, comm: Comm) -> None:
        super().__init__()
        self.places = comm.places
        self.decoder = _layers(comm.represents + PLACE * comm.places, comm.observed)

    def forward(
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


class Prediction(nn.Module):
    """What a representation z foretells, in learning alone: itself in the next frame.

        loss = |z_i + F([z_i, mean over j of S_i of A a_j]) - z'_i|^2 / numbers in z_i, mean over i
        S_i: those in contact with i, and i itself

    a_j is what j does. z'_i is the target network's, of the next frame, and constant; it lies n
    steps ahead with n-step windows, and a_j is the first of these steps'. F is a layer of 128
    ReLUs. In frames in a row gradients stay in their frame.

    Source: arXiv 2302.09605, without its rewards, projections and further steps.
    """

    def __init__(self, comm: Comm, num_actions: int) -> None:
        super().__init__()
        self.weight, self.num_actions = comm.predict, num_actions
        self.done = nn.Linear(num_actions, comm.represents)
        self.model = _layers(2 * comm.represents, comm.represents)

    def forward(
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


def prediction_of(comm: Comm, num_actions: int) -> Prediction | None:
    """Return what the scheme's representation foretells by; None: it need not."""
    return Prediction(comm, num_actions) if comm.represents and comm.predict else None


def predict_loss(
    part: Prediction, network: RobotsNetwork, target: RobotsNetwork, frames: TensorDictBase
) -> Float[Tensor, ""]:
    """Return how far what is foretold is from what comes, without the weight."""
    now = network(entries(network, frames)).talk.represented
    with torch.no_grad():
        then = target(entries(target, frames["next"])).talk.represented
    foretold = part(now, frames[keys.ACTION], frames[keys.ADJACENCY])
    return functional.mse_loss(foretold, then)


def _members(adjacency: Bool[Tensor, "*batch agent other"]) -> Bool[Tensor, "*batch agent other"]:
    itself = torch.eye(adjacency.shape[-1], dtype=torch.bool, device=adjacency.device)
    return adjacency | itself


def _layers(before: int, after: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(before, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, after))
