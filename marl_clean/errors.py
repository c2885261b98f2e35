"""What a user can get wrong, as one exception type.

The commands print its message on one line and leave with exit code 2.
"""


class BadInput(ValueError):
    """Input that cannot be used; the message names it, the reason and what would be valid."""
