"""Yaml from outside: small, plain data only, no anchors."""

from pathlib import Path
from typing import Any

import yaml

from marl_clean.errors import BadInput

LARGEST_BYTES = 1 << 20


def load_yaml(path: Path) -> Any:
    """The data in a yaml file: mappings, lists, texts, numbers.

    A few hundred bytes of nested anchors can stand for gigabytes, so anchors are refused.
    Raises BadInput when the file cannot be read, is larger than 1 MiB or is no such yaml.
    """
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise BadInput(f"{path}: larger than 1 MiB; not a settings file")
        text = path.read_text(encoding="utf-8")
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
                raise BadInput(f"{path}: has an anchor or alias; write the value out")
        return yaml.safe_load(text)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a yaml file that can be read") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        reason = str(error).splitlines()[0]
        raise BadInput(f"{path}: not plain yaml ({reason})") from error
