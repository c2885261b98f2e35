"""Every message arrives, at once and as it was sent."""

from marl_clean.channel.base import Channel


class Perfect(Channel):
    """Do nothing to messages."""
