"""Where the real floor plans are: MARL_CLEAN_MAPS, by default beside the repository."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def maps() -> Path:
    folder = Path(os.environ.get("MARL_CLEAN_MAPS", ROOT.parent / "shared" / "maps"))
    if not folder.is_dir():
        pytest.skip(f"no real floor plans at {folder}: set MARL_CLEAN_MAPS")
    return folder
