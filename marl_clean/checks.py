"""What a config asks of the machine: its floor plan, its folders, its device."""

from importlib.util import find_spec
from pathlib import Path

from omegaconf import DictConfig

from marl_clean.errors import BadInput
from marl_clean.house.base import draw_houses, split_seeds
from marl_clean.house.floorplan import FloorPlan
from marl_clean.schema import instantiate


def check_house(config: DictConfig) -> None:
    """Draw one house as training and evaluation will.

    Raises BadInput for a plan that cannot be read, has no free cell or fewer than robots, and
    for sizes that allow no house.
    """
    house = instantiate(config.house)
    draw_houses(house, split_seeds("test", 1), config.env.n_agents)


def check_plans(config: DictConfig) -> None:
    """Raises BadInput for a plan of `evaluation.plans` that cannot be read or holds no robots."""
    for path in config.evaluation.plans:
        try:
            draw_houses(FloorPlan(path), [], config.env.n_agents)
        except BadInput as error:
            raise BadInput(f"evaluation.plans: {error}") from None


def check_optimum(config: DictConfig) -> None:
    """Raises BadInput when the proven optimum is asked for and OR-tools is not installed."""
    if config.evaluation.get("optimum", False) and find_spec("ortools") is None:
        raise BadInput(
            "evaluation.optimum=true: needs OR-tools; pip install 'marl-clean[optimum]', or leave "
            "it out"
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


def check_device(device: str) -> None:
    """Raises BadInput when torch cannot use `device`; asks torch only when it is not the cpu."""
    if device == "cpu":
        return
    import torch

    gpus = [f"cuda:{index}" for index in range(torch.cuda.device_count())]
    valid = ["cpu", *(["cuda"] if gpus else []), *gpus]
    valid += ["mps"] if torch.backends.mps.is_available() else []
    if device not in valid:
        raise BadInput(f"device={device}: not on this machine; valid: {', '.join(valid)}")
