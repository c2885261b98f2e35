"""A scheme that takes more than features, as if all of it came from this step's features."""

from typing import Any

import torch
from torch import nn

from marl_clean.comm.base import Comm
from marl_clean.testing._graphs import FEATURES
from marl_clean.world.patches import NUM_CLASSES

FIRST = 3  # parameters that are always given: features, adjacency, senders


def reminded(comm: Comm) -> Comm:
    """Return the scheme, given what its robots' own features say where nothing else was given.

        hidden_i = tanh(R h_i),  read_i = tanh(S h_i),  R and S drawn at random

    of schemes that carry something from step to step, or read an entry of frames; read_i is cut
    into classes where those are of cells. So one step shows all that a robot may send.
    """
    generator = torch.Generator().manual_seed(0)
    widths = {"hidden": comm.remembers, "read": comm.reads_numbers}
    drawn = {
        name: torch.randn(FEATURES, width, generator=generator, dtype=torch.float64)
        for name, width in widths.items()
        if width
    }

    def remind(
        module: nn.Module, given: tuple[Any, ...], named: dict[str, Any]
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        if len(given) <= FIRST + 1:  # a delivery may come with these
            made = {name: (given[0] @ each).tanh() for name, each in drawn.items()}
            if comm.decodes and "read" in made:
                share = made["read"].nan_to_num() / 2 + 0.5
                made["read"] = (share * NUM_CLASSES).clamp(0, NUM_CLASSES - 1).to(torch.int8)
            named = made | named
        return given, named

    if drawn:
        comm.register_forward_pre_hook(remind, with_kwargs=True)
    return comm
