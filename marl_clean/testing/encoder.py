"""What every encoder must hold."""

import copy
from typing import Any

import torch
from torch import Tensor, nn

from marl_clean.settings import Form
from marl_clean.testing._broken import Clause, require, require_close, require_equal, verify
from marl_clean.testing._levels import Level, Maker, maker

SHAPES = {Form.SQUARES: ((1, 15, 15), (2, 9, 9)), Form.VECTOR: ((8,), (3,))}
CODES = torch.tensor([-1.0, -0.2, 0.0, 0.3, 0.5, 1.0])  # what a map holds
BATCHES = ((), (1,), (4,), (2, 3))
N_AGENTS = 3


def check_encoder(level: Level, **settings: Any) -> None:
    """An encoder makes a vector of each robot's own observation, whatever the batch.

        >>> check_encoder("mlp", hidden=[16])

    Raises:
        ContractBroken: what does not hold, with the numbers.
        BadInput: no such level or setting.
    """
    made = maker("encoder", level, settings)
    verify(made.label, CLAUSES, made)


def shapes_of(make: Maker) -> tuple[tuple[int, ...], ...]:
    """Return shapes of one robot's observation, of the form that the level takes."""
    takes = make.constant("takes")
    require(isinstance(takes, Form), f"takes is {takes!r}, not a Form")
    return SHAPES[takes]


def observed(*shape: int, seed: int = 0) -> Tensor:
    """Return observations."""
    generator = torch.Generator().manual_seed(seed)
    return CODES[torch.randint(len(CODES), shape, generator=generator)]


def encoders(make: Maker) -> list[tuple[tuple[int, ...], nn.Module]]:
    """Return an encoder for each shape, in eval mode."""
    result = []
    for shape in shapes_of(make):
        with torch.random.fork_rng([]):
            torch.manual_seed(0)
            result.append((shape, make(observation_shape=torch.Size(shape)).eval()))
    return result


def a_feature_vector_for_each_robot(make: Maker) -> None:
    """Features are finite float32 `[*batch, agent, out_features]`, whatever the batch."""
    for shape, encoder in encoders(make):
        for batch in BATCHES:
            feature = encoder(observed(*batch, N_AGENTS, *shape))
            wanted = [*batch, N_AGENTS, encoder.out_features]
            kind = f"{feature.dtype} {list(feature.shape)}"
            same = list(feature.shape) == wanted and feature.dtype == torch.float32
            require(same, f"gives {kind} for {[*batch, N_AGENTS, *shape]}, not float32 {wanted}")
            require(
                feature.isfinite(),
                f"gives values that are not finite for {[*batch, N_AGENTS, *shape]}",
            )
        memory = encoder.memory
        if memory is not None:
            width = getattr(memory, "hidden_size", None)
            fits = isinstance(memory, nn.GRUCell) and width == encoder.out_features
            require(fits, f"memory is {memory}, not a GRUCell as wide as the features")


def robots_do_not_see_each_other(make: Maker) -> None:
    """A robot's features depend on its own observation alone."""
    for shape, encoder in encoders(make):
        seen = observed(2, N_AGENTS, *shape)
        before = encoder(seen)
        for fill, what in ((CODES[0], "another observation"), (torch.tensor(torch.nan), "NaN")):
            other = seen.clone()
            other[:, 1] = fill
            after = encoder(other)
            for robot in (0, 2):
                broken = f"{what} of robot 1 changes the features of robot {robot}"
                require_close(after[:, robot], before[:, robot], broken)
        require((encoder(observed(2, N_AGENTS, *shape, seed=1)) != before).any(), "sees nothing")


def a_batch_equals_each_world_alone(make: Maker) -> None:
    """A world's features are what they are alone, and repeatable."""
    for shape, encoder in encoders(make):
        seen = observed(5, N_AGENTS, *shape)
        together = encoder(seen)
        require_equal(
            encoder(seen), together, "in eval mode, the same observation gives other features"
        )
        for world in range(5):
            alone = encoder(seen[world])
            require_close(together[world], alone, f"world {world} of 5 has other features alone")


def every_weight_learns(make: Maker) -> None:
    """Every weight gets a gradient, and robots with the same observation the same features."""
    for shape, encoder in encoders(make):
        seen = observed(16, N_AGENTS, *shape)
        encoder.train()(seen).square().sum().backward()
        for name, weight in encoder.named_parameters():
            if not name.startswith("memory."):  # the network runs the memory
                require(weight.grad is not None, f"{name} gets no gradient")
        alike = encoder.eval()(seen[:1, :1].expand_as(seen))
        first = alike[:1, :1].expand_as(alike)
        require_close(alike, first, "robots see the same, but have other features")


def a_copy_is_another_encoder(make: Maker) -> None:
    """It can be copied, and its weights can be stored and loaded."""
    for shape, encoder in encoders(make):
        seen = observed(2, N_AGENTS, *shape)
        twin = copy.deepcopy(encoder)
        for weight in twin.parameters():
            nn.init.normal_(weight)
        before = encoder(seen)
        twin.load_state_dict(encoder.state_dict())
        require_equal(twin(seen), before, "after loading its weights it gives other features")


CLAUSES: tuple[Clause, ...] = (
    a_feature_vector_for_each_robot,
    robots_do_not_see_each_other,
    a_batch_equals_each_world_alone,
    every_weight_learns,
    a_copy_is_another_encoder,
)
