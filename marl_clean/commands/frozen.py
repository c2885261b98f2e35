"""`study.yaml`: a study as it was when it was first run; what is run or reported later holds to it.

It has the section of the preset, the config of every arm, the hash of every run's config, and its
own sha256, so that a change by hand is noticed too.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig
from pydantic import BaseModel, ValidationError

from marl_clean import __version__
from marl_clean.commands.made_with import git_state
from marl_clean.commands.study_plan import Rule, read_study
from marl_clean.config.compose import leaves
from marl_clean.config.config_hash import LATER, OUTSIDE_THE_HASH, config_hash, container
from marl_clean.config.locate import own
from marl_clean.errors import BadInput
from marl_clean.storage import files
from marl_clean.storage.safe_yaml import load_yaml

FROZEN = "study.yaml"
SCHEMA = 1
HEAD = "# Written when the study was first run, and not changed after that: see docs/studies.md.\n"


class _Arm(BaseModel, strict=True):
    hashes: list[str]
    config: dict[str, Any]


class _Content(BaseModel, strict=True):
    """What readers of study.yaml need beside the section `study`, which `read_study` checks."""

    preset: str
    frozen: str
    version: str
    commit: str | None
    study: dict[str, Any]
    arms: dict[str, _Arm]


@dataclass(frozen=True)
class Frozen:
    """A study as its folder holds it."""

    folder: Path
    content: Mapping[str, Any]
    rules: Sequence[Rule]

    @property
    def study(self) -> dict[str, Any]:
        """The preset's section, with its defaults filled in."""
        return dict(self.content["study"])

    @property
    def hashes(self) -> dict[tuple[str, int], str]:
        """The hash of each run's config by arm and seed, in the order of the study."""
        return {
            (arm, seed): digest
            for arm, frozen in self.content["arms"].items()
            for seed, digest in zip(self.study["seeds"], frozen["hashes"], strict=True)
        }


def run_name(arm: str, seed: int) -> str:
    """The name of a run's folder in its study's."""
    return f"{arm}-s{seed}"


def to_freeze(
    preset: str, study: Mapping[str, Any], configs: Mapping[str, Sequence[DictConfig]]
) -> dict[str, Any]:
    """What is frozen of a study: its section, and of each arm its configs, one for each seed."""
    content = {
        "schema": SCHEMA,
        "preset": preset,
        "frozen": datetime.now(UTC).isoformat(timespec="seconds"),
        "version": __version__,
        "commit": commit(),
        "study": dict(study),
        "arms": {
            arm: {
                "hashes": [config_hash(config) for config in seeds],
                "config": _shared(container(seeds[0])),
            }
            for arm, seeds in configs.items()
        },
    }
    plain: dict[str, Any] = json.loads(json.dumps(content))  # no list twice, so no yaml anchor
    return plain | {"sha256": digest_of(plain)}


def freeze(folder: Path, content: Mapping[str, Any]) -> None:
    """Write study.yaml. Raises BadInput where it cannot be written, or runs have come before it."""
    if runs := sorted(path.parent.name for path in folder.glob("*/config.yaml")):
        raise BadInput(
            f"{folder}: holds {runs[0]}, which was run before a study was frozen here; "
            "begin with a name of its own: name=OTHER"
        )
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=100)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        files.write_file(folder / FROZEN, [(HEAD + text).encode()])
    except OSError as error:
        raise BadInput(f"{folder / FROZEN}: cannot be written: {error.strerror}") from error


def read_frozen(folder: Path) -> Frozen:
    """The study that is frozen in a folder; it may come from an untrusted source.

    Raises BadInput where it cannot be read, is of another version, or was changed by hand.
    """
    path = folder / FROZEN
    content = load_yaml(path)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise BadInput(f"{path}: is no frozen study of schema {SCHEMA}")
    if content.get("sha256") != digest_of(content):
        raise BadInput(
            f"{path}: was changed after it was frozen, its sha256 does not hold; restore it, or "
            "begin a new study: name=OTHER"
        )
    try:
        _Content.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))[:80]
        raise BadInput(f"{path}: is no frozen study: {place}: {first['msg']}") from error
    try:
        frozen = Frozen(folder, content, read_study(content["study"])[1])
        complete = {arm for arm, _ in frozen.hashes} == set(frozen.study["arms"])
    except ValueError as error:  # BadInput, or other than a hash for each seed
        raise BadInput(f"{path}: is no frozen study: {error}") from error
    if not complete:
        raise BadInput(f"{path}: is no frozen study: its arms are not those of its section")
    return frozen


def check_unchanged(frozen: Frozen, now: Mapping[str, Any]) -> None:
    """Raises BadInput where a study, as `to_freeze` has it now, is not the frozen one."""
    change = _change(frozen.content, now)
    if change is not None:
        name = frozen.folder.name
        raise BadInput(
            f"study {name}: {frozen.folder / FROZEN} was frozen with {change}; "
            "begin a new study with a name of its own: name=OTHER"
        )


def _change(old: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """The first difference in words; settings count by what they compose to."""
    for key in sorted(now["study"].keys() - {"arms", "question", "oracle"}):
        if text := _differing(old, now, "study", key):
            return text
    if list(old["arms"]) != list(now["arms"]) and set(old["arms"]) != set(now["arms"]):
        return f"arms {', '.join(old['arms'])}, not {', '.join(now['arms'])}"
    for arm, new in now["arms"].items():
        before = old["arms"][arm]
        if before["hashes"] == new["hashes"]:
            continue
        values = [dict(leaves(_shared(section["config"]))) for section in (before, new)]
        for key in dict.fromkeys((*values[0], *values[1])):
            was, has = (side.get(key, LATER.get(key)) for side in values)
            if was != has:
                return f"{key}={was} in arm {arm}, not {has}"
        return f"another config of arm {arm}"
    return None


def _differing(old: Mapping[str, Any], now: Mapping[str, Any], *path: str) -> str | None:
    """The difference of two values under the same keys, those inside a section one by one."""
    was, has = old, now
    for key in path:
        was, has = was.get(key), has.get(key)  # type: ignore[assignment]
    if was == has:
        return None
    if isinstance(was, dict) and isinstance(has, dict):
        for key in dict.fromkeys((*was, *has)):
            if text := _differing(old, now, *path, key):
                return text
    name = ".".join(path)
    if was is None:
        return f"no {name}"
    return f"{name}={was}, not {has}" if has is not None else f"{name}={was}, which is gone"


def _shared(config: Mapping[str, Any]) -> dict[str, Any]:
    """An arm's config without what differs between its runs, or is outside of the hash."""
    left_out = (*OUTSIDE_THE_HASH, "seed")
    return {key: value for key, value in config.items() if key not in left_out}


def digest_of(content: Mapping[str, Any]) -> str:
    """sha256 of all but the sha256 itself."""
    rest = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def commit() -> str | None:
    """The commit of the checkout that this package lies in, and whether files differ from it."""
    state = git_state(own().folder)
    return f"{state['commit']} and changes" if state["clean"] is False else state["commit"]
