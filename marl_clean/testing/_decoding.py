"""What schemes must hold whose receivers read in messages what lies around their senders."""

import torch
from torch import Tensor

from marl_clean.comm._decoding import Decoding
from marl_clean.comm.base import Comm
from marl_clean.testing._broken import require
from marl_clean.testing._graphs import draw
from marl_clean.world.patches import CLEANED, NUM_CLASSES, SIDE, UNKNOWN


def what_is_read_is_told_over_live_edges(comm: Comm) -> None:
    """A class for each cell of each sender, told over live edges; silence tells nothing."""
    if not isinstance(comm, Decoding):
        return
    feature, live, senders = draw(4, n_agents=5)
    told = comm(feature, live, senders).told
    require(told is not None, "decodes messages, but its talk has nothing that was told")
    assert told is not None
    dead = (told.live & ~live).nonzero().tolist()
    require(not dead, f"tells over dead edges: [world, receiver, sender] {dead[:1]}")
    patch = comm.patch_of(told.heard)
    wanted, shape = [4, 5, SIDE**2], list(patch.shape)
    require(shape == wanted, f"patch_of is {shape}, not {wanted}")
    lowest, highest = int(patch.min()), int(patch.max())
    inside = lowest >= UNKNOWN and highest <= CLEANED
    require(inside, f"patch_of has classes {lowest} to {highest}, not {UNKNOWN} to {CLEANED}")
    silent = comm.patch_of(torch.zeros_like(told.heard))
    require(not silent.any(), "a message of zeros, which is silence, tells of cells")


def code_loss(comm: Decoding) -> Tensor:
    """Return the loss of the scheme's code, on drawn patches."""
    generator = torch.Generator().manual_seed(0)
    patch = torch.randint(NUM_CLASSES, (4, 4, SIDE**2), generator=generator, dtype=torch.int8)
    return comm.code_loss(patch)
