"""What a config needs of its levels and of the machine: floor plan, folders, device.

Every command that composes a config goes through `check_all`: a new check is added to one of the
lists at the end of this file, and every command refuses what it refuses.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from marl_clean.commands._memory import check_memory
from marl_clean.commands.run_record import recorded_hash
from marl_clean.config.class_source import constant
from marl_clean.config.compose import has_houses
from marl_clean.config.fitting import check_fit
from marl_clean.config.installed import is_installed
from marl_clean.config.levels import EXPERIMENT, level_file, level_of, rooms
from marl_clean.config.overrides import parse_overrides
from marl_clean.config.presets import study_of
from marl_clean.config.schema import convert, instantiate
from marl_clean.config.stored import RUNS, check_same_run, find_run, load_config
from marl_clean.encoder._convolved import check_strides, fewest_weights, side_after
from marl_clean.errors import BadInput
from marl_clean.house.base import check_largest, draw_houses, split_seeds
from marl_clean.house.floorplan import FloorPlan
from marl_clean.house.rooms import Rooms
from marl_clean.settings import Form, KnowledgeOfTeam, Memory
from marl_clean.trainer._frames import check_frames
from marl_clean.world.rules import check_noted, knowledge_of_each


def check_house(config: DictConfig) -> None:
    """Draw one house as training and evaluation will; of a mixture one of every part.

    Raises BadInput for a plan that cannot be read, has no free cell or fewer than robots, and
    for sizes that allow no house, or larger ones than the observation has room for. Does
    nothing where there are no houses.
    """
    if not has_houses(config):
        return
    house = instantiate(config.house)
    widest = max(high for _, high in getattr(house, "margins", [[0, 0]]))
    for part in house.parts():
        houses = draw_houses(part, split_seeds("test", 1), config.env.n_agents)
        sides = [getattr(part, key, [0])[-1] for key in ("rows", "cols")]  # others may be larger
        around = 2 * widest if part.generated else 0
        largest = map(max, zip(sides, houses.free.shape[1:], strict=True))
        _check_sees(config, *(side + around for side in largest))


def check_knowledge(config: DictConfig) -> None:
    """Raises BadInput where what robots know or note does not fit robots, memory or sight."""
    if has_houses(config) and "knowledge" in config.env:
        env = OmegaConf.to_container(config.env)
        assert isinstance(env, dict)
        knowledge = convert(env["knowledge"], KnowledgeOfTeam)
        memory = Memory(env["memory"])
        knowledge_of_each(knowledge, memory, env["n_agents"])
        check_noted(env["robots_noted"], env["robots_shown"], memory)


def check_shows_houses(config: DictConfig) -> None:
    """Raises BadInput where a command that shows houses is given a config without them."""
    if not has_houses(config):
        raise BadInput("env: an external task has no houses, which this command shows")


def check_plans(config: DictConfig) -> None:
    """Raises BadInput for a plan of `evaluation.plans` that cannot be read, holds no robots, or
    is larger than the observation has room for."""
    for path in config.evaluation.plans if has_houses(config) else ():
        try:
            houses = draw_houses(FloorPlan(path), [], config.env.n_agents)
            _check_sees(config, *houses.free.shape[1:])
        except BadInput as error:
            raise BadInput(f"evaluation.plans: {error}") from None


def check_sides(config: DictConfig) -> None:
    """Raises BadInput for a side of `evaluation.sides` of which there are no houses, or larger
    ones than the observation has room for."""
    sides = config.evaluation.get("sides", [])
    if sides and not has_houses(config):
        raise BadInput("evaluation.sides: env is an external task; valid: []")
    for side in sides:
        try:
            draw_houses(Rooms([side, side], [side, side]), [0], config.env.n_agents)
            _check_sees(config, side, side)
        except BadInput as error:
            raise BadInput(f"evaluation.sides: {side}: {error}") from None


def check_teams(config: DictConfig) -> None:
    """Raises BadInput for a size of `evaluation.team_sizes` that the learner cannot have, or for
    which the houses have no room; an external task brings its own robots."""
    for size in config.evaluation.get("team_sizes", []):
        if not has_houses(config):
            raise BadInput("evaluation.team_sizes: env is an external task; valid: []")
        if "env.n_agents" in (constant(config.agent._target_, "sized_by") or []):
            level = level_of(config.agent._target_)
            raise BadInput(
                f"evaluation.team_sizes: agent={level} is of env.n_agents robots; valid: []"
            )
        team = config.copy()
        team.env.n_agents = size
        try:
            check_house(team)
            check_knowledge(team)
        except BadInput as error:
            raise BadInput(f"evaluation.team_sizes: {size}: {error}") from None


def _check_sees(config: DictConfig, rows: int, cols: int) -> None:
    largest = config.observation.get("largest_side")
    if largest is not None:
        check_largest(largest, rows, cols)


def check_square_view(config: DictConfig, what: str) -> None:
    """Raises BadInput when robots do not see a square around themselves, which `what` shows."""
    gives = constant(config.observation._target_, "gives")
    if gives is not Form.SQUARES or "view_size" not in config.observation:
        level = level_of(config.observation._target_)
        raise BadInput(f"observation={level}: {what} needs a square around the robot, as of crop")


def check_old_houses(config: DictConfig) -> None:
    """Raises BadInput where the houses of the run that training starts from cannot be drawn.

    They are measured after training, and the file of their floor plan may have moved.
    """
    if config.checkpoint is None:
        return
    old = config.copy()
    old.house = load_config(find_run(config.checkpoint))["house"]
    try:
        check_house(old)
    except BadInput as error:
        raise BadInput(f"checkpoint={config.checkpoint}: its houses: {error}") from None


def check_imitate(config: DictConfig) -> None:
    """Raises BadInput where `trainer.imitate` is no planner, or there are no houses to plan for."""
    name = config.trainer.get("imitate")
    if name is None:
        return
    planners = rooms()["planner"]
    if name not in planners:
        valid = ", ".join([*planners, "null"])
        raise BadInput(f"trainer.imitate={name}: is no planner; valid: {valid}")
    if not has_houses(config):
        raise BadInput(
            f"trainer.imitate={name}: planners need houses, which env has none of; valid: null"
        )


def check_optimum(config: DictConfig) -> None:
    """Raises BadInput when the proven optimum is asked for and OR-tools is not installed."""
    if config.evaluation.get("optimum", False) and not is_installed("ortools"):
        raise BadInput(
            "evaluation.optimum=true: needs OR-tools; pip install 'marl-clean[optimum]', or leave "
            "it out"
        )


EXTRA_LOGGERS = ("wandb", "mlflow")
"""Loggers whose package is an extra of the same name."""


def check_loggers(config: DictConfig) -> None:
    """Raises BadInput when a logger is chosen whose package is not installed."""
    for level in EXTRA_LOGGERS:
        if level in (config.logger or ()) and not is_installed(level):
            raise BadInput(
                f"logger={level}: {level} is not installed; pip install 'marl-clean[{level}]',"
                " or leave it out"
            )


def check_no_study(settings: Sequence[str]) -> None:
    """Raises BadInput where settings choose a preset that is a study, which has arms of its own."""
    for override in parse_overrides(settings, allow_hydra=True):
        if override.key != EXPERIMENT:
            continue
        for preset in override.values if override.is_sweep else [override.value]:
            if preset is not None and study_of(level_file(EXPERIMENT, str(preset))) is not None:
                raise BadInput(
                    f"experiment={preset}: is a study of several arms; marl-clean study {preset}"
                )


def check_out(path: Path) -> None:
    """Raises BadInput when no file can be written at `path`."""
    if path.is_dir():
        raise BadInput(f"out={path}: is a folder; give a file's name, such as {path}/out.json")
    for parent in path.parents:
        if parent.exists():
            if not parent.is_dir():
                raise BadInput(f"out={path}: {parent} is not a folder; give another file")
            return


def check_sizes(config: DictConfig) -> None:
    """Raises BadInput where sizes of the encoder or the training loop do not fit each other.

    Levels that have other keys, or a view whose side only they know, check their own when built.
    """
    env, encoder, budget = config.env, config.encoder, config.parameter_budget
    check_frames(config.trainer, env.num_envs)
    if "strides" not in encoder:
        return
    check_strides(encoder.channels, encoder.strides)
    if "view_size" in config.observation:
        shape = (encoder.kernel_size, encoder.strides, encoder.padding)
        side_after(config.observation.view_size, *shape)
    least = fewest_weights(encoder.channels, encoder.kernel_size)
    if budget is not None and budget < least:
        raise BadInput(
            f"parameter_budget={budget}: the encoder's convolutions have {least} weights already;"
            " give more"
        )


def check_run_folder(config: DictConfig) -> None:
    """Raises BadInput when the folder of the run's name is a file, or a run of another config."""
    folder = RUNS / config.name
    for place in (folder, *folder.parents):
        if place.exists() and not place.is_dir():
            raise BadInput(f"name={config.name}: {place} is a file; choose another name")
    check_same_run(config, folder, recorded_hash(folder))


def check_intervention(config: DictConfig, intervention: str | None) -> None:
    """Raises BadInput where an intervention is given without the run whose messages it changes."""
    if intervention is not None and config.checkpoint is None:
        raise BadInput(
            f"intervention={intervention}: needs checkpoint=RUN, whose messages to change"
        )


def check_device(config: DictConfig) -> None:
    """Raises BadInput when torch cannot use the device; torch is imported only for a GPU."""
    device = config.device
    if device == "cpu":
        return
    import torch

    gpus = [f"cuda:{index}" for index in range(torch.cuda.device_count())]
    valid = ["cpu", *(["cuda"] if gpus else []), *gpus]
    valid += ["mps"] if torch.backends.mps.is_available() else []
    if device not in valid:
        raise BadInput(f"device={device}: not on this machine; valid: {', '.join(valid)}")


def check_compile(config: DictConfig) -> None:
    """Raises BadInput when the env is to be compiled and torch lies in a path with a space.

    torch 2.13 does not quote that path for the linker (pytorch/pytorch pull request 191010).
    """
    torch = find_spec("torch")
    if not config.env.get("compile", False) or torch is None or torch.origin is None:
        return
    if " " in torch.origin:
        raise BadInput(
            f"env.compile=true: torch cannot compile where its path has a space, {torch.origin}; "
            "start Python by a link to its environment without one, or leave it out"
        )


def check_all(config: DictConfig, training: bool = False, here: bool = True) -> None:
    """Raises BadInput where a config cannot be used: by any command, or for `training`.

    `here`: whether this machine will use it.
    """
    for check in (*CHECKS, *(OF_TRAINING if training else ()), *(OF_THE_MACHINE if here else ())):
        check(config)
    if here:
        check_memory(config, training)


CHECKS = [check_optimum, check_house, check_knowledge]
OF_TRAINING = [
    check_fit,
    check_sizes,
    check_imitate,
    check_plans,
    check_sides,
    check_teams,
    check_old_houses,
    check_run_folder,
    check_loggers,
]
OF_THE_MACHINE = [check_compile, check_device]
