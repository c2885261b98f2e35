"""Every message arrives, at once and as it was sent."""

from typing import final

from marl_clean.channel.base import Channel


@final
class Perfect(Channel):
    """Do nothing to messages."""
