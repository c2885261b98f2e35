"""What a user can get wrong, as one exception type.

The commands print its message on one line and leave with exit code 2.
"""


class BadInput(ValueError):
    """Input that cannot be used; the message names it, the reason and what would be valid.

    A message is one line of printable characters, whatever it quotes: file names, and texts out of
    files, may hold line ends and sequences that steer a terminal.
    """

    def __init__(self, message: object = "") -> None:
        text = " ".join(str(message).split())
        super().__init__("".join(map(_printable, text)))


def _printable(character: str) -> str:
    """The character, or its escape."""
    if character.isprintable():
        return character
    return character.encode("unicode_escape").decode("ascii")
