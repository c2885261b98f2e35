"""Curves and the config for Weights & Biases, by TorchRL's logger."""

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import final

from torchrl.record.loggers import WandbLogger

from marl_clean.logger.base import Logger, stored_settings
from marl_clean.storage import files


@final
class Wandb(Logger):
    """Write every value, clock times included, and the run's config, into `wandb` of its folder.

    The run is called like its folder. A resumed one goes on under the id of the first, which is
    kept beside what wandb writes.

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
            id=self._run_id(frames),
            project=self.project,
            settings={"silent": self.offline},  # what it prints names servers that are not asked
        )
        self.writer.log_hparams(stored_settings(self.folder))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the run"
        self.writer.log_metrics(dict(values), step=frames, override_global_step=True)

    def add_replay(self, gif: Path, frames: int) -> None:
        """Log the GIF as it is, in the run of the training."""
        import wandb

        self.resume(frames)
        assert self.writer is not None
        self.writer.experiment.log({gif.stem: wandb.Video(str(gif), format="gif")}, step=frames)
        self.close()

    def close(self) -> None:
        if self.writer is not None:
            self.writer.experiment.finish()

    def _run_id(self, frames: int) -> str:
        """The id of the run that is resumed, or a new one: a name alone may have been used."""
        path = self.folder / "wandb" / "id.txt"
        if not frames or not path.is_file():
            with files.writing(path):
                path.parent.mkdir(exist_ok=True)
                files.write_file(path, [uuid.uuid4().hex[:16].encode()])
        return path.read_text(encoding="ascii")
