"""Curves for TensorBoard, by TorchRL's logger."""

from collections.abc import Mapping
from pathlib import Path
from typing import final

from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torchrl.record.loggers import TensorboardLogger

from marl_clean.logger.base import Logger

RGB = 3  # TensorBoard's code of the colours


@final
class TensorBoard(Logger):
    """Write every value, clock times included, into the run's folder `tensorboard`.

    A resumed run writes the frames after its checkpoint once more, with the same values.

    Args:
        folder: the run's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.writer: TensorboardLogger | None = None

    def resume(self, frames: int) -> None:
        self.writer = TensorboardLogger("tensorboard", str(self.folder))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        assert self.writer is not None, "resume() opens the file"
        for name, value in values.items():
            self.writer.log_scalar(name, value, step=frames)

    def add_replay(self, gif: Path, frames: int) -> None:
        """Write the GIF among the images, which TensorBoard plays; its videos are GIFs too."""
        with Image.open(gif) as picture:
            width, height = picture.size
        image = Summary.Image(
            width=width, height=height, colorspace=RGB, encoded_image_string=gif.read_bytes()
        )
        self.resume(frames)
        assert self.writer is not None
        summary = Summary(value=[Summary.Value(tag=gif.stem, image=image)])
        self.writer.experiment.file_writer.add_summary(summary, frames)
        self.close()

    def close(self) -> None:
        if self.writer is not None:
            self.writer.experiment.close()
