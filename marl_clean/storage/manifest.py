"""The manifest that proves a checkpoint, and which checkpoints a run has; without torch.

A checkpoint is a folder `<kind>-<frames>` of tensors.safetensors, state.json and manifest.json;
the manifest holds length and sha256 of the other two.
"""

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage._header import read_header
from marl_clean.storage.reading import TooLarge, parse_json, read_bytes

FOLDER = "checkpoints"
TENSORS, STATE, MANIFEST = "tensors.safetensors", "state.json", "manifest.json"
WEIGHT_KINDS = ("best", "final")  # kinds that hold weights alone, in order of preference
SCHEMA = 1
LARGEST_MANIFEST, LARGEST_STATE = 1 << 12, 16 << 20  # bytes
MOST_VALUES = 1_000_000
LARGEST_WEIGHTS = 4 << 30  # bytes: those of a billion numbers
NAME = re.compile(r"([a-z]+)-(\d{12})")


class Damaged(Exception):
    """A checkpoint that is not what was written; the message says how."""


def paths(folder: Path, kind: str | None = None) -> list[Path]:
    """The checkpoints of a kind, or of all, in a folder, newest first."""
    matches = ((NAME.fullmatch(path.name), path) for path in folder.glob("*-*"))
    checkpoints = [(m[2], m[1], path) for m, path in matches if m and kind in (None, m[1])]
    return [path for _, _, path in sorted(checkpoints, reverse=True)]


def verify(path: Path) -> dict[str, files.Digest]:
    """Check every file against the manifest; return their digests.

    Raises Damaged where a file is not what was written.
    """
    manifest = read_json(path / MANIFEST, LARGEST_MANIFEST)
    digests = {}
    for name in (TENSORS, STATE):
        if (path / name).is_symlink() or not (path / name).is_file():
            raise Damaged(f"{name} is missing")
        _check_length(path, name, manifest)
        digests[name] = files.digest_of(path / name)
    if make_manifest(digests) != canonical(manifest):
        raise Damaged("the manifest does not hold")
    return digests


def _check_length(path: Path, name: str, manifest: Any) -> None:
    """Raises Damaged for another length than the manifest's, or one that weights do not have.

    A file may be said to be as long as a disk and take no room on it; to read it takes hours.
    """
    length = (path / name).stat().st_size
    described = manifest.get("files") if isinstance(manifest, dict) else None
    about = described.get(name) if isinstance(described, dict) else None
    if not isinstance(about, dict) or about.get("bytes") != length:
        raise Damaged("the manifest does not hold")
    if path.name.partition("-")[0] in WEIGHT_KINDS and length > LARGEST_WEIGHTS:
        raise Damaged(f"{name} is larger than {LARGEST_WEIGHTS >> 30} GiB, the most for weights")


def weights_sha256(run: Path) -> str:
    """The sha256 of a run's weights: the best, else the last.

    Raises BadInput where it has no undamaged ones.
    """
    for kind in WEIGHT_KINDS:
        for path in paths(run / FOLDER, kind):
            try:
                return verify(path)[TENSORS].sha256
            except Damaged:
                continue
    raise BadInput(f"{run}: has no whole weights yet; train it until its first evaluation")


def count_weights(run: Path) -> int | None:
    """The number of parameters of a run's policy; None where it has no readable weights."""
    for kind in WEIGHT_KINDS:
        for path in paths(run / FOLDER, kind):
            with suppress(OSError, ValueError):
                return sum(held.numel for held in read_header(path / TENSORS).values())
    return None


def make_manifest(digests: Mapping[str, files.Digest]) -> bytes:
    """The manifest's content."""
    described = {name: asdict(digest) for name, digest in digests.items()}
    return canonical({"schema": SCHEMA, "files": described})


def canonical(tree: Any) -> bytes:
    """The one canonical JSON of a tree: keys sorted, no spaces."""
    return json.dumps(tree, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def read_json(path: Path, largest: int = LARGEST_STATE) -> Any:
    """The tree in a JSON file of at most `largest` bytes. Raises Damaged where there is none."""
    if path.is_symlink() or not path.is_file():
        raise Damaged(f"{path.name} is missing")
    try:
        return parse_json(read_bytes(path, largest), MOST_VALUES)
    except TooLarge as error:
        raise Damaged(f"{path.name} is larger than {largest:,} bytes") from error
    except BadInput as error:
        raise Damaged(str(error)) from error
    except ValueError as error:
        raise Damaged(f"{path.name} is not JSON: {error}") from error
