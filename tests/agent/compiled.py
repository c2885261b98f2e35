"""Compile the network of every comm level and variant in one graph: it tells the same as before.

A script of its own, because the run-time checks of the tests cannot be compiled.
"""

from pathlib import Path

import torch
from omegaconf import OmegaConf

from marl_clean.build import make_comm
from marl_clean.networks import QNetwork
from marl_clean.schema import instantiate
from tests.comm.contract import DILUTED, VARIANTS

CONF = Path(__file__).parents[2] / "conf"


def main() -> None:
    observation = torch.tensor([-1.0, -0.2, 0.0, 0.3, 1.0])[torch.randint(5, (2, 3, 1, 15, 15))]
    live = torch.tensor([[[0, 1, 0], [1, 0, 0], [0, 0, 0]]] * 2, dtype=torch.bool)
    rank = torch.tensor([[[0, 1, 2], [1, 0, 2], [2, 1, 0]]] * 2)
    for level, changes in VARIANTS + DILUTED:
        encoder = instantiate(
            OmegaConf.load(CONF / "encoder" / "cnn.yaml"), observation_shape=torch.Size([1, 15, 15])
        )
        section = OmegaConf.merge(OmegaConf.load(CONF / "comm" / f"{level}.yaml"), changes)
        comm = make_comm(section, encoder.out_features, torch.Size([1, 15, 15]))
        torch.compiler.reset()  # each is a network of its own, and so many are not kept
        network = QNetwork(encoder, comm, dueling=True, precision="float32")
        compiled = torch.compile(network, fullgraph=True, backend="eager")
        network.eval()  # bits and gates are drawn while learning
        specs = network.state_specs(live.shape[-1])
        seen = observation, live, rank, *(specs[key].zero([2]) for key in network.carries)
        for mine, theirs in zip(flat(network(*seen)), flat(compiled(*seen)), strict=True):
            torch.testing.assert_close(mine, theirs)


def flat(result: tuple) -> list[torch.Tensor]:
    value, talk, carried = result
    return [value, *talk[:4], *carried]


if __name__ == "__main__":
    main()
