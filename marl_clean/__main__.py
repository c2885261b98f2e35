"""`python -m marl_clean COMMAND` is `marl-clean COMMAND`."""

import sys

from marl_clean.commands._signals import end_at_once_by_signals


def main() -> int:
    """Run one command and return its exit code; signals end it as they should from here on."""
    end_at_once_by_signals()
    from marl_clean import cli

    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
