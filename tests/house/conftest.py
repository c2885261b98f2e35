"""Where the real floor plans are: MARL_CLEAN_MAPS, by default beside the repository."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from marl_clean.house._plan_files import warn_once

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def maps() -> Path:
    folder = Path(os.environ.get("MARL_CLEAN_MAPS", ROOT.parent / "shared" / "maps"))
    if not folder.is_dir():
        pytest.skip(f"no real floor plans at {folder}: set MARL_CLEAN_MAPS")
    return folder


@pytest.fixture(scope="module", autouse=True)
def drawn_once() -> None:
    """Override that of all tests: here houses are drawn anew."""


@pytest.fixture(autouse=True)
def warned_of_nothing_yet() -> Iterator[None]:
    """Warnings come once a process; every test is to see its own."""
    warn_once.cache_clear()
    yield
