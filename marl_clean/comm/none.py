"""No communication: every robot decides from what it sees itself."""

from typing import final

from marl_clean.comm._quiet import Quiet


@final
class Silent(Quiet):
    """Return the features unchanged; messages are empty and cost nothing."""
