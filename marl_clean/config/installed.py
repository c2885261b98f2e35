"""Whether a library that an extra brings is installed."""

from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec


def is_installed(distribution_name: str, module: str | None = None) -> bool:
    """Whether a distribution is installed and its `module`, of the same name if None, is there.

    A folder `ray` where a command is started is a module to Python, and not the library.
    """
    try:
        distribution(distribution_name)
    except PackageNotFoundError:
        return False
    return find_spec(module or distribution_name) is not None
