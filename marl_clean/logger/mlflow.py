"""Curves and the config for MLflow, by TorchRL's logger."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from torchrl.record.loggers import MLFlowLogger

from marl_clean.config.compose import leaves
from marl_clean.logger.base import Logger, stored_settings


@final
class MlFlow(Logger):
    """Write every value, clock times included, and the run's config, to an MLflow server or file.

    The run is called like its folder. A resumed one is a second MLflow run of that name, which
    begins at the checkpoint.

    Args:
        folder: the run's.
        tracking_uri: of a server or a database; null: an SQLite file `mlflow.db` in the folder.
        experiment: in which the run appears.
    """

    def __init__(
        self, folder: Path, tracking_uri: str | None = None, experiment: str = "marl_clean"
    ) -> None:
        self.folder, self.experiment = folder, experiment
        self.tracking_uri = tracking_uri or f"sqlite:///{folder.absolute() / 'mlflow.db'}"
        self.writer: MLFlowLogger | None = None

    def resume(self, frames: int) -> None:
        import mlflow

        self.writer = MLFlowLogger(self.experiment, self.tracking_uri)
        mlflow.set_tag("mlflow.runName", self.folder.name)
        # MLflow's parameters are flat.
        self.writer.log_hparams(dict(leaves(stored_settings(self.folder))))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the run"
        self.writer.log_metrics(dict(values), step=frames)

    def close(self) -> None:
        if self.writer is not None:
            import mlflow

            mlflow.end_run()
