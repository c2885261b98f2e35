"""Which resets take the short path of TransformedWorlds."""

import pytest

from marl_clean.env.transformed import TransformedWorlds


def count_short_resets(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list to which each reset by the short path appends how many worlds began anew."""
    begun: list[int] = []
    direct = TransformedWorlds.begin_anew

    def noted(self, carried, done, rows) -> None:
        begun.append(len(rows))
        direct(self, carried, done, rows)

    monkeypatch.setattr(TransformedWorlds, "begin_anew", noted)
    return begun
