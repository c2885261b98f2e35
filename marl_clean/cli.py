"""`marl-clean COMMAND [key=value ...]`: one thin function a command.

The config is composed and checked first; only then is torch imported. Exit codes: 0 done, 1
`doctor` reports a problem, a sweep or study has jobs that are not finished, or a search no trial
with a value, 2 bad input (one line on stderr), 130 interrupted, 143 terminated.
"""

import argparse
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from marl_clean import __version__
from marl_clean.commands._signals import begin, handled
from marl_clean.commands.arguments import WITHOUT_SETTINGS, parser_of, plugin_option
from marl_clean.errors import BadInput, memory_that_lacked

if TYPE_CHECKING:
    from omegaconf import DictConfig

INTERVENE = "intervention="  # of evaluate: not a setting of the config, and may be a list
BAD_INPUT, INTERRUPTED = 2, 128 + signal.SIGINT


def train(arguments: argparse.Namespace) -> int:
    """train a policy and evaluate it on held-out houses; the same command again resumes"""
    from marl_clean.commands.checks import check_no_study

    check_no_study(arguments.settings)
    if arguments.multirun:
        return begin("sweep").run(arguments.settings)
    from marl_clean.commands.checks import check_all
    from marl_clean.config.stored import RUNS, compose_for_training
    from marl_clean.storage.lock import check_free

    config = compose_for_training(arguments.settings)
    check_all(config, training=True)
    check_free(RUNS / config.name)
    begin("train").main(config, RUNS / config.name)
    return 0


def tune(arguments: argparse.Namespace) -> int:
    """search any keys for the best value of a measure, by Optuna; the same command again resumes"""
    return begin("tune").run(arguments.settings)


def study(arguments: argparse.Namespace) -> int:
    """run the study of a preset: arms, seeds, rules, frozen before the first run; resumes"""
    if "=" in arguments.name:
        raise BadInput(f"study: {arguments.name!r} is a setting; name a preset before it")
    return begin("study").main(arguments.name, arguments.settings)


def evaluate(arguments: argparse.Namespace) -> int:
    """measure checkpoint=RUN or planner=NAME on held-out houses or on a plan; intervention=all"""
    from marl_clean.commands.checks import check_all, check_intervention, check_out
    from marl_clean.config.config_hash import config_hash
    from marl_clean.config.stored import EVALUATED, RUNS, compose_for_policy

    texts = [text for text in arguments.settings if text.startswith(INTERVENE)]
    intervention = texts[-1].removeprefix(INTERVENE) if texts else None
    settings = [text for text in arguments.settings if not text.startswith(INTERVENE)]
    config = compose_for_policy(settings)
    check_all(config)
    check_intervention(config, intervention)
    name = config.name
    if config.checkpoint is not None and len(settings) > 1:  # measured elsewhere
        name = f"{name}-{config_hash(config)[:8]}"
    out = Path(config.out or RUNS / EVALUATED / name / "evaluation.json")
    check_out(out)
    command = begin("evaluate")
    from marl_clean.evaluation.interventions import named

    command.main(config, out, interventions=() if intervention is None else named(intervention))
    return 0


def verify(arguments: argparse.Namespace) -> int:
    """repeat a run's first updates: are its weights the same here, bit for bit?"""
    return begin("verify").main(arguments.run)


def watch(arguments: argparse.Namespace) -> int:
    """show one episode in the terminal, of checkpoint=RUN or planner=NAME"""
    from marl_clean.config.stored import compose_for_policy

    config = compose_for_policy(arguments.settings)
    _check_in_houses(config)
    begin("watch").main(config)
    return 0


def figure(arguments: argparse.Namespace) -> int:
    """draw a figure, such as paper_1, into runs/figures; comparisons train what they need"""
    from marl_clean.commands.comparison import COMPARISONS
    from marl_clean.config.stored import compose_for_policy

    if "=" in arguments.name:
        raise BadInput(f"figure: {arguments.name!r} is a setting; name a figure before it")
    if arguments.name in COMPARISONS:
        begin("comparison").main(arguments.name, arguments.settings)
        return 0
    config = compose_for_policy(arguments.settings)
    _check_in_houses(config)
    begin("figure").main(arguments.name, config)
    return 0


def compare(arguments: argparse.Namespace) -> int:
    """finished runs in one table, seeds pooled, compared with one of them on the same houses"""
    named = {key: getattr(arguments, key) for key in ("against", "export", "silent", "oracle")}
    begin("compare").main(arguments.runs, arguments.out, **named)
    return 0


def report(arguments: argparse.Namespace) -> int:
    """finished runs, or a study, on one page: tables, plots, episodes to play"""
    study_report, command = begin("study_report"), begin("report")
    if (folder := study_report.folder_in(arguments.runs)) is not None:
        study_report.main(folder, arguments.out, None, arguments.against, arguments.oracle)
        return 0
    command.main(arguments.runs, arguments.out, None, arguments.against, arguments.oracle)
    return 0


def matrix(arguments: argparse.Namespace) -> int:
    """policies trained over one channel, measured over others: a matrix and its figure"""
    begin("matrix").main(arguments.runs, arguments.channel or (), arguments.houses, arguments.out)
    return 0


def headroom(arguments: argparse.Namespace) -> int:
    """what planners gain from maps and targets of others: where a message can pay at all"""
    begin("headroom").run(arguments.settings)
    return 0


def runs(arguments: argparse.Namespace) -> int:
    """list what is in runs/: state, seed, score, size, age; --clean removes what is not needed"""
    chosen = (arguments.state or (), arguments.preset or ())
    begin("runs").main(arguments.patterns, *chosen, arguments.clean, arguments.yes)
    return 0


def benchmark(arguments: argparse.Namespace) -> int:
    """measure speed, into runs/benchmark.json"""
    from marl_clean.commands.checks import check_all, check_shows_houses, check_square_view
    from marl_clean.config.compose import compose_config

    config = compose_config(arguments.settings)
    check_shows_houses(config)
    check_square_view(config, "benchmark")
    config.env.compile = True  # after the settings: a machine that cannot compile hides no fault
    check_all(config)
    begin("benchmark").main(config)
    return 0


def list_levels(arguments: argparse.Namespace) -> int:
    """the rooms and their levels, a line each"""
    from marl_clean.commands.listing import lines

    _write(lines())
    return 0


def doctor(arguments: argparse.Namespace) -> int:
    """what is installed, what is missing, how to fix it"""
    from marl_clean.commands.doctor import findings, lines_of

    report = list(findings())
    _write(lines_of(report))
    return int(any(finding.remedy for finding in report))


COMMANDS = {
    "train": train,
    "tune": tune,
    "study": study,
    "evaluate": evaluate,
    "verify": verify,
    "watch": watch,
    "figure": figure,
    "compare": compare,
    "report": report,
    "matrix": matrix,
    "headroom": headroom,
    "runs": runs,
    "benchmark": benchmark,
    "list": list_levels,
    "doctor": doctor,
}
USAGE = """\
marl-clean COMMAND [key=value ...]

{commands}

Settings are Hydra overrides: `comm=none` selects a level of a room, `env.n_agents=4` sets a key,
`+experiment=NAME` applies a preset; `train -m seed=0,1,2` runs every combination. `marl-clean
list` shows the choices; `marl-clean COMMAND --help` shows one command. `--plugin PACKAGE` after
any command brings in levels of a package of your own.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    with handled() as signals:
        try:
            code = _run(sys.argv[1:] if argv is None else argv)
            sys.stdout.flush()
            return code
        except BadInput as error:
            return _refuse(str(error))
        except KeyboardInterrupt:
            return INTERRUPTED
        except BrokenPipeError:  # the reader of our output, such as `head`, has left
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except Exception as error:
            if signals.number is not None:  # a library made another exception of the signal's
                return 128 + signals.number
            if (reason := memory_that_lacked(error)) is None:
                raise
            return _refuse(reason)


def _refuse(reason: str) -> int:
    sys.stderr.write(f"marl-clean: {' '.join(reason.split())}\n")
    return BAD_INPUT


def _run(argv: Sequence[str]) -> int:
    name = argv[0] if argv else "--help"
    if name in ("-h", "--help"):
        _write([_usage()])
        return 0
    if name == "--version":
        _write([__version__])
        return 0
    if name not in COMMANDS:
        from marl_clean.config.schema import choices

        raise BadInput(f"{name}: no such command; {choices(name, COMMANDS)}")
    from marl_clean.commands.command_line import issued
    from marl_clean.config.locate import plugins_in_use

    early, _ = plugin_option().parse_known_args(argv[1:])
    with plugins_in_use(early.plugin), issued(argv):
        shows_help = bool({"-h", "--help"}.intersection(argv))
        parser = parser_of(name, COMMANDS[name].__doc__ or "", shows_help)
        arguments = parser.parse_intermixed_args(argv[1:])
        if name not in WITHOUT_SETTINGS:
            from marl_clean.commands.shorthand import with_floor_plans

            arguments.settings = with_floor_plans(arguments.settings)
        return COMMANDS[name](arguments)


def _usage() -> str:
    commands = (f"  {name:10} {run.__doc__}" for name, run in COMMANDS.items())
    return USAGE.format(commands="\n".join(commands))


def _check_in_houses(config: "DictConfig") -> None:
    from marl_clean.commands.checks import check_all, check_shows_houses

    check_shows_houses(config)
    check_all(config)


def _write(lines: Iterable[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))
