"""What each command takes on its command line."""

import argparse
from pathlib import Path
from typing import NoReturn

from marl_clean.errors import BadInput

WITHOUT_SETTINGS = ("list", "doctor", "compare", "report", "matrix", "runs", "verify")
RUN = {
    "compare": "finished runs, or exports",
    "report": "finished runs, or exports; or one study, by its name or folder",
}
ALSO = {"compare": "; draws runs/figures/compare.svg and .png, compare_2 of a second world, ..."}


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are BadInput like all others."""

    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message}; `{self.prog} --help` shows what is valid")


def plugin_option() -> Parser:
    """Return the parser of `--plugin`, which takes effect before anything else is read."""
    parser = Parser(add_help=False, allow_abbrev=False)
    parser.add_argument(
        "--plugin",
        metavar="PACKAGE",
        action="append",
        default=[],
        help="a package whose conf/ brings levels of its own; may be repeated",
    )
    return parser


def parser_of(name: str, does: str, shows_help: bool = False) -> Parser:
    """Return a command's parser; `does` is what its help says, with `shows_help` levels too."""
    parser = Parser(
        prog=f"marl-clean {name}",
        description=f"{does}{ALSO.get(name, '')}{_own_settings(name)}",
        epilog=_levels() if shows_help and name not in WITHOUT_SETTINGS else None,
        parents=[plugin_option()],
    )
    if name == "figure":
        parser.add_argument("name", metavar="NAME", help="the figure, such as paper_1")
    if name == "study":
        parser.add_argument("name", metavar="NAME", help="a preset or yaml file with a `study`")
    if name == "verify":
        parser.add_argument("run", metavar="RUN", help="a run, by folder or name")
    if name == "train":
        parser.add_argument("-m", "--multirun", action="store_true", help="all combinations")
    if name in ("compare", "report"):
        parser.add_argument("runs", metavar="RUN", nargs="+", help=RUN[name])
        written = {
            "compare": "rows as json, OUT_paired.json, ... beside",
            "report": "where to write the page; default: report.html in runs/ or the study",
        }
        parser.add_argument("--out", type=Path, help=written[name])
        parser.add_argument(
            "--against", metavar="ROW", help="label of the row that the others are compared with"
        )
    if name in ("compare", "report"):
        named = "label of a row, or runs by folder or 'GLOB'"
        oracle = f"{named}, of any memory: with all that a message could say; adds gaps to it"
        parser.add_argument("--oracle", metavar="ROW", help=oracle)
    if name == "compare":
        silent = f"{named}: without messages; default: comm=none"
        parser.add_argument("--silent", metavar="ROW", help=silent)
        parser.add_argument("--export", type=Path, metavar="FOLDER", help="json, csv and LaTeX")
    if name == "matrix":
        parser.add_argument("runs", metavar="RUN", nargs="+", help="folders of runs")
        parser.add_argument(
            "--channel",
            metavar="STACK",
            action="append",
            help="such as lossy(loss=0.5),quantised; may be repeated; default: the runs' own",
        )
        parser.add_argument("--houses", type=int, help="number of test houses")
        parser.add_argument("--out", type=Path, help="where to write the cells as json")
    if name == "runs":
        from marl_clean.commands.runs import add_arguments

        add_arguments(parser)
    if name not in WITHOUT_SETTINGS:
        parser.add_argument("settings", metavar="key=value", nargs="*", help="Hydra overrides")
    return parser


def _own_settings(name: str) -> str:
    if name == "tune":
        from marl_clean.commands._tune_settings import described
    elif name == "headroom":
        from marl_clean.commands._headroom_settings import described
    else:
        return ""
    return f"; its own settings: {described()}"


def _levels() -> str:
    from marl_clean.config.levels import rooms

    return "levels: " + "; ".join(f"{room}={','.join(names)}" for room, names in rooms().items())
