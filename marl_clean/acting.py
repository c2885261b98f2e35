"""What the policies of several learners share: reading and writing a network's step in a frame."""

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import TensorDictPrimer

from marl_clean import keys
from marl_clean.comm.base import Talk
from marl_clean.networks import RobotsNetwork

TOLD = (keys.MESSAGE, keys.MESSAGE_EDGES, keys.MESSAGE_BITS)


def entries(network: RobotsNetwork, frame: TensorDictBase) -> list[Tensor]:
    """Return what the network takes, in its order; zeros for what no step has carried yet."""
    found = [frame.get(key) for key in network.sees]
    if network.carries and found[-1] is None:
        specs = network.state_specs(frame.get(keys.ADJACENCY).shape[-1])
        begin = [specs[key].zero(frame.batch_size).to(frame.device) for key in network.carries]
        found[-len(begin) :] = begin
    return found


def primer(network: RobotsNetwork, n_agents: int) -> TensorDictPrimer:
    """Return TorchRL's transform that lets the episodes of an env begin with nothing carried."""
    specs = Composite({keys.AGENTS: Composite(shape=(n_agents,))})
    specs.update(network.state_specs(n_agents))
    return TensorDictPrimer(specs, default_value=0.0, expand_specs=True)


def note_carried(
    frame: TensorDictBase, carries: Sequence[NestedKey], carried: Sequence[Tensor]
) -> None:
    """Write what is carried to where the next frame will have it."""
    for key, value in zip(carries, carried, strict=True):
        frame.set(("next", key), value)


def note_talk(frame: TensorDictBase, talk: Talk) -> None:
    """Write what was said, and what it cost."""
    for key, value in zip(TOLD, (talk.message, talk.edges, talk.bits), strict=True):
        frame.set(key, value)
