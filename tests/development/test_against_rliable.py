"""A development test: rliable is archived and wants pandas below 3, so no extra installs it."""

from importlib.util import find_spec

import pytest


@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("rliable") is None, reason="needs rliable; see tests/development/against_rliable.py"
)
def test_our_statistics_are_rliables(capsys: pytest.CaptureFixture[str]) -> None:
    from tests.development import against_rliable

    assert against_rliable.main() == 0, capsys.readouterr().out
