"""What runs on a GPU: the CPU's worlds, nothing left on the host, no wait that is not named.

Where there is no GPU the tests that need one are skipped, and those that stand in for them remain:
the path of a GPU, walked on a CPU, in which what a GPU would be waited for is counted.
"""

import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import marl_clean
from marl_clean import BadInput, build, cli, keys
from marl_clean.config.compose import compose_config
from marl_clean.config.schema import instantiate
from marl_clean.env import cleaning
from marl_clean.env.transform import WorldTransform
from marl_clean.observation import compass
from marl_clean.storage.checkpoint import Checkpoints
from marl_clean.trainer.base import TrainingLoop
from marl_clean.world import distance, floods, potential, spills, step
from marl_clean.world.dynamics import MOVES, moves_on
from marl_clean.world.state import State

needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")

ANY_HOUSE = [
    "+experiment=any_house",
    "env.num_envs=8",
    "env.max_steps=20",  # so that episodes end
    "train_houses=8",
    "trainer.frames_per_batch=256",
    "trainer.minibatch_frames=128",
    "trainer.imitate=null",  # whoever plans may wait
]
SPILLING = ["env.spills.per_episode=4", "env.spills.noticed_within=3", "env.memory=private"]
STEPS = 256 // 8
WAITS = {"floods.py", "transformed.py"}  # in a step: docs/speed.md says why
PACKAGE = Path(marl_clean.__file__).parent
READS = ("_local_scalar_dense", "nonzero", "masked_select", "lift_fresh", "equal")


def loop_on(device: str, folder: Path, settings: Sequence[str] = ()) -> TrainingLoop:
    """A training of `any_house`, about to begin."""
    cfg = compose_config([*ANY_HOUSE, *settings, f"device={device}"])
    torch.manual_seed(0)
    env = build.make_env(cfg)
    agent = build.make_agent(cfg, env)
    env = build.ready_for(agent, env)
    trainer = instantiate(cfg.trainer)
    return trainer.begin(env, agent, lambda policy: {}, [], Checkpoints(folder))


@needs_gpu
def test_worlds_are_those_of_a_cpu() -> None:
    settings = [*ANY_HOUSE, *SPILLING, "observation.position_noise=0.1"]
    envs = [build.make_env(compose_config([*settings, f"device={d}"])) for d in ("cpu", "cuda")]
    carried = [env.reset() for env in envs]
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        action = torch.randint(0, 4, (8, 2), generator=generator)
        for index, env in enumerate(envs):
            carried[index][keys.ACTION] = action.to(env.device)
            carried[index] = env.step_and_maybe_reset(carried[index])[1]
        own, theirs = (env.base_env.state.tensors() for env in envs)
        for name, value in own.items():
            assert torch.equal(value, theirs[name].cpu()), name
        for key in (keys.OBSERVATION, keys.POTENTIAL, keys.ACTION_MASK, keys.ADJACENCY):
            torch.testing.assert_close(carried[0][key], carried[1][key].cpu(), atol=1e-6, rtol=0)


@needs_gpu
def test_any_house_trains_there(tmp_path: Path) -> None:
    loop = loop_on("cuda", tmp_path)
    before = [weight.clone() for weight in loop.agent.network.parameters()]
    for _ in range(3):
        block = loop.collect()
        assert {value.device.type for value in block.values(True, True)} == {"cuda"}
        loop.learn(block)
    weights = list(loop.agent.network.parameters())
    assert all(weight.is_cuda and weight.isfinite().all() for weight in weights)
    assert not all(map(torch.equal, before, weights))


@needs_gpu
@pytest.mark.parametrize("before", ["cpu", "cuda"])
def test_an_interrupted_run_goes_on_there(before: str, tmp_path: Path) -> None:
    stopped = loop_on(before, tmp_path)
    stopped.learn(stopped.collect())
    stopped.save()
    loop = loop_on("cuda", tmp_path)
    loop.resume()
    assert loop.frames == stopped.frames
    for name, value in loop.env.base_env.state.tensors().items():
        assert value.is_cuda and torch.equal(
            value.cpu(), getattr(stopped.env.base_env.state, name).cpu()
        )
    loop.learn(loop.collect())


@needs_gpu
def test_a_step_waits_for_what_is_named_alone(tmp_path: Path) -> None:
    loop = loop_on("cuda", tmp_path)
    loop.learn(loop.collect())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            next(loop.collectors.blocks)
        finally:
            torch.cuda.set_sync_debug_mode("default")
    waits = Counter(
        Path(each.filename).name for each in caught if "called a synchronizing" in str(each.message)
    )
    assert set(waits) == WAITS and waits["transformed.py"] == STEPS


class Reads(TorchDispatchMode):
    """Counts, by the file of ours that asks, the operations for which a GPU would be waited for."""

    def __init__(self) -> None:
        super().__init__()
        self.by_file: Counter[str] = Counter()

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        name = operation.name().removeprefix("aten::").partition(".")[0]
        picks = name in ("index", "index_put", "index_put_", "_index_put_impl_")
        masks = picks and any(index is not None and index.dtype == torch.bool for index in args[1])
        if masks or name in READS:
            files = [Path(frame.filename) for frame in traceback.extract_stack()]
            own = [file.name for file in files if file.is_relative_to(PACKAGE)]
            self.by_file[own[-1]] += 1
        return operation(*args, **(kwargs or {}))


def every_world(due: torch.Tensor) -> torch.Tensor:
    return torch.arange(len(due), device=due.device)


def take_the_path_of_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search by floods, see by tensors, and look at no action."""
    for module in (potential, compass):
        monkeypatch.setattr(module, "walking_distance", floods.flood)
    monkeypatch.setattr(compass, "first_steps", floods.flood_first_steps)
    monkeypatch.setattr(compass.Compass, "by_machine_code", compass.Compass.by_tensors)
    monkeypatch.setattr(potential, "by_machine_code", potential.by_tensors)
    monkeypatch.setattr(cleaning, "check_actions", lambda action: None)
    monkeypatch.setattr(spills, "within_steps", floods.flood_within)
    monkeypatch.setattr(spills, "worlds_to_spill_in", every_world)


@pytest.mark.long
@pytest.mark.parametrize("settings", [[], SPILLING], ids=["plain", "spills"])
def test_nothing_else_is_read_from_a_step(
    settings: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take_the_path_of_a_gpu(monkeypatch)
    loop = loop_on("cpu", tmp_path, settings)
    with Reads() as reads:
        block = next(loop.collectors.blocks)
    assert block["next", keys.DONE].any()
    assert set(reads.by_file) == WAITS and reads.by_file["transformed.py"] == STEPS


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [
        [],
        ["env.memory=private", "env.sensor=touch4", "observation.position_noise=0.1"],
        ["env.memory=merged", "topology=sight"],
        [*SPILLING, "env.sensor=touch4"],
    ],
    ids=["shared", "private", "merged", "spills"],
)
def test_all_is_made_on_the_device_of_the_worlds(
    settings: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a device without numbers: a tensor left on the CPU would not go together with others."""
    take_the_path_of_a_gpu(monkeypatch)

    def distances(passable, sources):
        return torch.where(sources, 0, distance.UNREACHABLE).to(torch.int32)

    def ways(passable, goals, start, others, rivals):
        steps = torch.zeros((*start.shape, 4), dtype=torch.bool, device=start.device)
        return steps, torch.zeros_like(start, dtype=torch.int32)

    for module in (potential, compass):  # how far a flood runs depends on numbers
        monkeypatch.setattr(module, "walking_distance", distances)
    monkeypatch.setattr(compass, "first_steps", ways)
    env = build.make_env(compose_config([*ANY_HOUSE, *settings]))
    worlds, setup = env.base_env, env.base_env.setup
    state = State(**{name: value.to("meta") for name, value in worlds.state.tensors().items()})
    setup = setup._replace(
        houses=type(setup.houses)(*(each.to("meta") for each in setup.houses)),
        env_index=setup.env_index.to("meta"),
        seed=setup.seed.to("meta"),
    )
    transforms = [each.to("meta") for each in env.transforms if isinstance(each, WorldTransform)]
    reads = [transform.read for transform in transforms]
    action = torch.zeros((8, 2), dtype=torch.int64, device="meta")
    _, after = step.step_(state, action, worlds.moves.to("meta"), setup, None, step.Along(reads))
    if setup.rules.spills.per_episode:
        spills.spill_(state, setup)
    rows = torch.arange(3, device="meta")
    _, begun = step.begin_rows_(state, setup, rows, state.episode[rows] + 1, reads)
    made = [*after.entries.values(), *begun.values(), *state.tensors().values()]
    assert {value.device.type for value in made} == {"meta"}


def test_moves_are_the_listed_ones() -> None:
    assert torch.equal(moves_on(torch.device("cpu")), torch.tensor(MOVES))


@pytest.mark.slow
def test_without_a_gpu_none_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 0)
    refused = "device=cuda: not on this machine; valid: cpu"
    for command in (
        "train +experiment=any_house",
        "evaluate checkpoint=approach_2_frontier",
        "evaluate planner=random",
    ):
        assert cli.main([*command.split(), "device=cuda"]) == cli.BAD_INPUT
        out, err = capsys.readouterr()
        assert out == "" and refused in err and err.count("\n") == 1
    for ask in (
        lambda: marl_clean.train("any_house", device="cuda"),
        lambda: marl_clean.evaluate("approach_2_frontier", device="cuda"),
        lambda: marl_clean.make_env("any_house", device="cuda"),
    ):
        with pytest.raises(BadInput, match=refused):
            ask()
    assert not list(tmp_path.iterdir())
