"""Curves for TensorBoard, by TorchRL's logger."""

import logging
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import final

from PIL import Image
from tensorboard.compat.proto.summary_pb2 import Summary
from torchrl.record.loggers import TensorboardLogger

from marl_clean.logger.base import Logger
from marl_clean.storage import files

FOLDER = "tensorboard"
RGB = 3  # TensorBoard's code of the colours
log = logging.getLogger(__name__)


@final
class TensorBoard(Logger):
    """Write every value, clock times included, into the run's folder `tensorboard`.

    A resumed run writes the frames after its checkpoint once more, with the same values. Each row
    is on the disk before the next begins: TensorBoard's thread would tell later that it is full.

    Args:
        folder: the run's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.writer: TensorboardLogger | None = None

    def resume(self, frames: int) -> None:
        path = self.folder / FOLDER
        if path.exists() and not path.is_dir():
            log.warning("%s: is no folder; no curves are written there", path)
            return
        threading.excepthook = _unless_kept
        with files.writing(path):
            self.writer = TensorboardLogger(FOLDER, str(self.folder))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        if self.writer is None:
            return
        with files.writing(self.folder / FOLDER):
            for name, value in values.items():
                self.writer.log_scalar(name, value, step=frames)
            self.writer.experiment.flush()

    def add_replay(self, gif: Path, frames: int) -> None:
        """Write the GIF among the images, which TensorBoard plays; its videos are GIFs too."""
        with Image.open(gif) as picture:
            width, height = picture.size
        image = Summary.Image(
            width=width, height=height, colorspace=RGB, encoded_image_string=gif.read_bytes()
        )
        self.resume(frames)
        if self.writer is not None:
            summary = Summary(value=[Summary.Value(tag=gif.stem, image=image)])
            with files.writing(self.folder / FOLDER):
                self.writer.experiment.file_writer.add_summary(summary, frames)
        self.close()

    def close(self) -> None:
        writer, self.writer = self.writer, None
        if writer is not None:
            with files.writing(self.folder / FOLDER):
                writer.experiment.close()


def _unless_kept(failed: threading.ExceptHookArgs) -> None:
    """Print the traceback of a thread that failed, unless the thread keeps it for its caller.

    TensorBoard's does both: what it keeps is raised by the next call.
    """
    if getattr(failed.thread, "exception", None) is not failed.exc_value:
        threading.__excepthook__(failed)
