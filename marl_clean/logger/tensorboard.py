"""Curves for TensorBoard."""

import itertools
import logging
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, final

from PIL import Image
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from marl_clean.logger.base import Logger
from marl_clean.storage import files

FORMAT = "brain.Event:2"  # what TensorBoard expects at the beginning of a file
RGB = 3  # TensorBoard's code of the colours
log = logging.getLogger(__name__)
_numbers = itertools.count()


@final
class TensorBoard(Logger):
    """Write every value, clock times included, into the run's folder `tensorboard`.

    A resumed run writes the frames after its checkpoint once more, with the same values. The file
    is written here and not by TensorBoard's thread, which would tell of a full disk too late and in
    a traceback of its own.

    Args:
        folder: the run's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "tensorboard"
        self.file: BinaryIO | None = None

    def resume(self, frames: int) -> None:
        if self.folder.exists() and not self.folder.is_dir():
            log.warning("%s: is no folder; no curves are written there", self.folder)
            return
        number = f"{int(time.time()):010d}.{socket.gethostname()}.{os.getpid()}.{next(_numbers)}"
        with files.writing(self.folder):
            self.folder.mkdir(exist_ok=True)
            self.file = (self.folder / f"events.out.tfevents.{number}").open("wb")
        self._add(Event(file_version=FORMAT))

    def log(self, frames: int, values: Mapping[str, float]) -> None:
        each = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._add(Event(step=frames, summary=Summary(value=each)))

    def add_replay(self, gif: Path, frames: int) -> None:
        """Write the GIF among the images, which TensorBoard plays; its videos are GIFs too."""
        with Image.open(gif) as picture:
            width, height = picture.size
        image = Summary.Image(
            width=width, height=height, colorspace=RGB, encoded_image_string=gif.read_bytes()
        )
        self.resume(frames)
        value = Summary.Value(tag=gif.stem, image=image)
        self._add(Event(step=frames, summary=Summary(value=[value])))
        self.close()

    def close(self) -> None:
        file, self.file = self.file, None
        if file is not None:
            with files.writing(self.folder):
                file.close()

    def _add(self, event: Event) -> None:
        """Write an event to the disk, if there is a file."""
        if self.file is None:
            return
        event.wall_time = time.time()
        with files.writing(self.folder):
            RecordWriter(self.file).write(event.SerializeToString())
            self.file.flush()
