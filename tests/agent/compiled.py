"""Compile the networks of every comm level, variant and channel in one graph: all tell the same.

A script of its own, because the run-time checks of the tests cannot be compiled. Graphs are
captured for all, with gradients for schemes that sum and attend; `inductor` makes machine code of
one that carries all that can be carried. With arguments, of those comm levels and gradients
instead.
"""

import sys
from pathlib import Path

import torch
from omegaconf import OmegaConf
from torch._inductor import config as inductor

from marl_clean import keys
from marl_clean.build import make_comm
from marl_clean.channel.base import Channel
from marl_clean.config.class_source import takes
from marl_clean.config.levels import read_level
from marl_clean.config.schema import instantiate
from marl_clean.learning.networks import Decision, Entries, QNetwork
from marl_clean.observation.crop import Crop
from tests.comm.contract import DILUTED, LEVELS, TALKING, VARIANTS, draw, make

CONF = Path(__file__).parents[2] / "conf"
N_AGENTS = 3
CHANNELS = [path.stem for path in sorted((CONF / "channel").glob("*.yaml"))]
EVERYTHING = {
    "lossy": {"burst_start": 0.2},
    "delayed": {"steps": 2, "random": True},
    "quantised": {},
    "noisy": {},
    "budget": {"messages": 4},
}


def main() -> None:
    # To find out what vectors the compiler can make takes seconds, and the graphs are the same; so
    # do processes that compile, and fast machine code.
    inductor.cpp.vec_isa_ok = False
    inductor.compile_threads = 1
    inductor.aot_inductor.debug_compile = True
    levels = sys.argv[1:]
    for level in levels or ("commnet", "tarmac"):
        check_gradients(level, "inductor" if levels else "aot_eager")
    if levels:
        return
    for level, changes in VARIANTS + DILUTED:
        if changes.keys() - {"places", "join", "detach"}:  # these come with every level below
            check(level, changes, {}, "none", "eager")
    check("commnet", {}, {channel: {} for channel in CHANNELS}, "none", "eager")
    for level, _ in LEVELS:
        changes = {"places": True, "join": "residual"} if level in TALKING else {}
        changes |= {"detach": True} if "detach" in read_level("comm", level) else {}
        check(level, changes, {"lossy": {}, "delayed": {}}, "gru", "eager")
    check("dgn", {}, EVERYTHING, "gru", "aot_eager")
    remembering = {name: EVERYTHING[name] for name in ("lossy", "delayed")}
    check("plan", {}, remembering, "gru", "inductor")


def check(level: str, changes: dict, channels: dict[str, dict], memory: str, backend: str) -> None:
    section = OmegaConf.merge(OmegaConf.load(CONF / "encoder" / "cnn.yaml"), {"memory": memory})
    encoder = instantiate(section, observation_shape=torch.Size([1, 15, 15]), spread=Crop.spread)
    section = OmegaConf.create({**read_level("comm", level), **changes})
    comm = make_comm(section, encoder.out_features, torch.Size([1, 15, 15]))
    dims = tuple(comm.message_dims)
    stack = {name: make_channel(name, dims, some) for name, some in channels.items()}
    torch.compiler.reset()  # each is a network of its own, and so many are not kept
    network = QNetwork(encoder, comm, dueling=True, precision="bfloat16", channels=stack)
    network.eval()  # bits and gates are drawn while learning
    compiled = torch.compile(network, fullgraph=True, backend=backend)
    seen = entries(network)
    for learned, expected in zip(flat(network(seen)), flat(compiled(seen)), strict=True):
        torch.testing.assert_close(learned, expected, atol=1e-4, rtol=1e-4)


def check_gradients(level: str, backend: str) -> None:
    """A scheme alone: what it gives, and what it hands back."""
    torch.compiler.reset()
    comm = make(level).float()
    feature, live, rank = draw(2, n_agents=N_AGENTS)
    feature = feature.float().requires_grad_()
    compiled = torch.compile(comm, fullgraph=True, backend=backend)
    plain, fast = (one(feature, live, rank)[:4] for one in (comm, compiled))
    back = [torch.autograd.grad(talk[0].square().sum(), feature)[0] for talk in (plain, fast)]
    for learned, expected in zip((*plain, back[0]), (*fast, back[1]), strict=True):
        torch.testing.assert_close(learned, expected, atol=1e-4, rtol=1e-4)


def make_channel(name: str, dims: tuple[int, ...], changes: dict) -> Channel:
    section = OmegaConf.merge(OmegaConf.load(CONF / "channel" / f"{name}.yaml"), changes)
    parts = {"message_dims": dims} if takes(section["_target_"], "message_dims") else {}
    return instantiate(section, **parts)


def entries(network: QNetwork) -> Entries:
    observation = torch.tensor([-1.0, -0.2, 0.0, 0.3, 1.0])[torch.randint(5, (2, 3, 1, 15, 15))]
    live = torch.tensor([[[0, 1, 0], [1, 0, 0], [0, 0, 0]]] * 2, dtype=torch.bool)
    rank = torch.tensor([[[0, 1, 2], [1, 0, 2], [2, 1, 0]]] * 2)
    seen = {keys.OBSERVATION: observation, keys.ADJACENCY: live, keys.DISTANCE_RANK: rank}
    if network.comm.places:
        seen[keys.OFFSET] = torch.randint(-5, 6, (2, N_AGENTS, N_AGENTS, 2))
    if network.comm.reads is not None:
        read = torch.randint(4, (2, N_AGENTS, network.comm.reads_numbers))
        seen[keys.AGENTS, network.comm.reads] = read
    if network.draws:
        seen[keys.CHANNEL_SEED] = torch.randint(2**32, (2, N_AGENTS))
    specs = network.state_specs(N_AGENTS)
    return seen | {key: specs[key].rand([2]) for key in network.carries}


def flat(result: Decision) -> list[torch.Tensor]:
    return [result.out, *result.talk[:4], *result.carried.values()]


if __name__ == "__main__":
    main()
