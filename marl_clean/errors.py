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


CANNOT_ALLOCATE = ("can't allocate memory", "not enough memory", "out of memory")  # torch's words


def memory_that_lacked(error: Exception) -> str | None:
    """Which memory an error says that there was not, and what would need less; None for others."""
    said = str(error)
    if not isinstance(error, MemoryError) and not any(w in said for w in CANNOT_ALLOCATE):
        return None
    [first, *_] = said.strip().splitlines() or ["an allocation failed"]
    return (
        f"not enough memory ({first[:200]}); fewer trainer.buffer_frames, env.num_envs or"
        " trainer.frames_per_batch, or a smaller observation need less"
    )
