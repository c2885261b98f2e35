"""The first updates of a run, by digests of the weights after them: what `verify` repeats."""

import hashlib
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import torch
from pydantic import BaseModel, Field, ValidationError
from torch import Tensor, nn

from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage.reading import open_ordinary

log = logging.getLogger(__name__)
FILE = "first_updates.json"
VERSION = 1
BLOCKS = 3  # blocks of frames after which weights were updated
LARGEST = 10_000  # bytes of such a file


class Updated(BaseModel, strict=True, frozen=True):
    """The weights after a block: `updates` so far, from `frames`, and what they hash to."""

    frames: Annotated[int, Field(ge=0, lt=2**63)]
    updates: Annotated[int, Field(ge=1, lt=2**63)]
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _File(BaseModel, strict=True):
    version: Annotated[int, Field(lt=2**63)]
    updated: Annotated[list[Updated], Field(max_length=BLOCKS)]


class Repeated(Exception):
    """Raised by a training that was to make the first updates alone."""


class FirstUpdates:
    """Notes the weights after each of the first blocks that updated them, in the run's folder.

    Args:
        folder: the run's.
        alone: end the training with `Repeated` as soon as the last is noted.
    """

    def __init__(self, folder: Path, alone: bool = False) -> None:
        self.path, self.alone = folder / FILE, alone
        self.updated: list[Updated] = []
        self.complete = False

    def resume(self, frames: int, updates: int) -> None:
        """Go on after `frames` and `updates`: what a run noted until then stays.

        A run whose first notes are missing or damaged notes no others, which are not its first.
        """
        if not updates:  # there is nothing that it could have noted
            return
        try:
            self.updated = [each for each in read(self.path) if each.frames <= frames]
        except BadInput as error:
            log.warning("%s; its first updates cannot be verified", error)
            self.complete = True

    def note(self, frames: int, updates: int, network: nn.Module) -> None:
        """Note the weights if they were updated since the last note, and not often before."""
        before = self.updated[-1].updates if self.updated else 0
        if self.complete or len(self.updated) == BLOCKS or updates <= before:
            return
        digest = digest_of(network.state_dict())
        self.updated.append(Updated(frames=frames, updates=updates, sha256=digest))
        content = _File(version=VERSION, updated=self.updated).model_dump_json(indent=1)
        try:
            files.write_file(self.path, [content.encode() + b"\n"])
        except OSError as error:  # a full disk stops no run here; states and weights tell of it
            log.warning("%s: cannot be written: %s", self.path, error.strerror)
        if self.alone and len(self.updated) == BLOCKS:
            raise Repeated


def digest_of(weights: Mapping[str, Tensor]) -> str:
    """Return a sha256 of names, shapes, types and bits of weights, in the order of names."""
    digest = hashlib.sha256()
    for name in sorted(weights):
        weight = weights[name].detach().cpu().contiguous()
        digest.update(f"{name} {tuple(weight.shape)} {weight.dtype}\n".encode())
        digest.update(weight.flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def read(path: Path) -> list[Updated]:
    """Return what a run noted; the file may come from an untrusted source.

    Raises:
        BadInput: it cannot be read, or is not such a file.
    """
    try:
        with open_ordinary(path) as file:
            text = file.read(LARGEST + 1)
        if len(text) > LARGEST:
            raise BadInput(f"{path}: is larger than {LARGEST} bytes")
        content = _File.model_validate_json(text)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise BadInput(f"{path}: holds no first updates: {error.errors()[0]['msg']}") from error
    if content.version != VERSION:
        raise BadInput(f"{path}: is of version {content.version}; valid: {VERSION}")
    return content.updated
