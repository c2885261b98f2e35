"""`python -m marl_clean COMMAND` is `marl-clean COMMAND`."""

import sys

from marl_clean.cli import main

if __name__ == "__main__":
    sys.exit(main())
