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
        # Beside a database of the run's own; MLflow's default is the working directory.
        artifacts = folder.absolute() / "mlartifacts"
        self.artifact_location = None if tracking_uri else artifacts.as_uri()
        self.tracking_uri = tracking_uri or f"sqlite:///{folder.absolute() / 'mlflow.db'}"
        self.writer: MLFlowLogger | None = None

    def resume(self, frames: int) -> None:
        import mlflow

        self.writer = MLFlowLogger(
            self.experiment, self.tracking_uri, artifact_location=self.artifact_location
        )
        mlflow.set_tag("mlflow.runName", self.folder.name)
        # MLflow's parameters are flat.
        self.writer.log_hparams(dict(leaves(stored_settings(self.folder))))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the run"
        self.writer.log_metrics(dict(values), step=frames)

    def add_replay(self, gif: Path, frames: int) -> None:
        """Store the GIF as an artifact of the newest MLflow run of this name."""
        from mlflow import MlflowClient

        client = MlflowClient(self.tracking_uri)
        experiment = client.get_experiment_by_name(self.experiment)
        assert experiment is not None, "resume() has made it"
        newest = client.search_runs(
            [experiment.experiment_id],
            f"tags.mlflow.runName = '{self.folder.name}'",
            order_by=["attributes.start_time DESC"],
            max_results=1,
        )
        client.log_artifact(newest[0].info.run_id, str(gif))

    def close(self) -> None:
        if self.writer is not None:
            import mlflow

            mlflow.end_run()
