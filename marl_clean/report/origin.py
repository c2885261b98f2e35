"""Where a figure comes from, written into the file itself: the command and the configs behind it.

An svg holds it as `dc:source` and `dc:identifier` of its RDF metadata, a png as the texts `Source`
and `Identifier`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

SOURCE, IDENTIFIER = "Source", "Identifier"  # names of the Dublin Core
CONFIG = "config sha256"


@dataclass(frozen=True)
class Origin:
    """What made a figure.

    Attributes:
        command: as it can be given again in a shell.
        config_hashes: of every config that it shows; each is named once, in this order.
    """

    command: str
    config_hashes: Iterable[str]

    def metadata(self) -> dict[str, str]:
        """Return the texts by their names, as Matplotlib's `savefig(metadata=...)` takes them."""
        hashes = " ".join(dict.fromkeys(self.config_hashes))
        return {SOURCE: self.command, IDENTIFIER: f"{CONFIG} {hashes}"}
