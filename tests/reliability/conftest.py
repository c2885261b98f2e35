"""A training that harnesses disturb; to make it costs more than to disturb it."""

import pytest
import torch

from tests.reliability.kills import Training


@pytest.fixture(scope="session")
def iql(tmp_path_factory: pytest.TempPathFactory) -> Training:
    torch.set_num_threads(1)
    return Training("iql", tmp_path_factory.mktemp("disturbed"))
