"""Every test runs with the shapes and types in the annotations checked at run time."""

from collections.abc import Iterator

from jaxtyping import install_import_hook

install_import_hook("marl_clean", "beartype.beartype")

import pytest  # noqa: E402  (nothing may import the package before the hook)
import torch  # noqa: E402


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Let a run be repeated to the last bit, and two tests at once not wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
