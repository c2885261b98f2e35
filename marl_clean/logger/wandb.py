"""Curves and the config for Weights & Biases, by TorchRL's logger."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from omegaconf import OmegaConf
from torchrl.record.loggers import WandbLogger

from marl_clean.logger.base import Logger


@final
class Wandb(Logger):
    """Write every value, clock times included, and the run's config, into `wandb` of its folder.

    The run is called like its folder. A resumed one goes on under the same id.

    Args:
        folder: the run's.
        project: in which the run appears.
        offline: keep everything on the disk, for `wandb sync`. Else wandb's own login is used.
    """

    def __init__(self, folder: Path, project: str = "marl_clean", offline: bool = True) -> None:
        self.folder, self.project, self.offline = folder, project, offline
        self.writer: WandbLogger | None = None

    def resume(self, frames: int) -> None:
        self.writer = WandbLogger(
            self.folder.name,
            offline=self.offline,
            save_dir=str(self.folder),
            id=self.folder.name,
            project=self.project,
            settings={"silent": self.offline},  # what it prints names servers that are not asked
        )
        config = self.folder / "config.yaml"
        if config.is_file():
            self.writer.log_hparams(OmegaConf.load(config))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the run"
        self.writer.log_metrics(dict(values), step=frames, override_global_step=True)

    def close(self) -> None:
        if self.writer is not None:
            self.writer.experiment.finish()
