"""Curves and the config for MLflow, by TorchRL's logger."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, final

from omegaconf import DictConfig, ListConfig, OmegaConf
from torchrl.record.loggers import MLFlowLogger

from marl_clean.logger.base import Logger


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
        config = self.folder / "config.yaml"
        if config.is_file():
            self.writer.log_hparams(dict(leaves(OmegaConf.load(config))))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the run"
        self.writer.log_metrics(dict(values), step=frames)

    def close(self) -> None:
        if self.writer is not None:
            import mlflow

            mlflow.end_run()


def leaves(config: DictConfig | ListConfig, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every setting by its dotted key; MLflow's parameters are flat. Lists stay whole."""
    for key, value in config.items() if isinstance(config, DictConfig) else ():
        if isinstance(value, DictConfig):
            yield from leaves(value, f"{prefix}{key!s}.")
        else:
            yield f"{prefix}{key!s}", value
