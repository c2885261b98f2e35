"""What became of the jobs of a sweep: a table in the end, and the exit code."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import DictConfig
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from marl_clean.commands.run_info import FAILED, MEASURED, State, is_finished, look
from marl_clean.evaluation.records import Entry, read_entries
from marl_clean.evaluation.table import interval, is_yardstick, output, ratio_to

NOT_ALL = 1
AGAIN = "the same command tries what failed again, and resumes what is unfinished"


@dataclass(frozen=True)
class Ending:
    """What became of one job: its state, why where it is not finished, and what it measured."""

    name: str
    state: State
    reason: str = ""
    entries: tuple[Entry, ...] = ()

    @classmethod
    def of(cls, config: DictConfig, folder: Path) -> "Ending":
        """Look at the job's folder."""
        if is_finished(config, folder):
            return cls(config.name, State.FINISHED, "", tuple(read_entries(folder / MEASURED)))
        info = look(folder, config.name)
        if info.holder is not None:
            return cls(config.name, State.RUNNING, f"held by {info.holder}")
        if info.reason is not None:
            return cls(config.name, State.FAILED, f"{info.reason} ({folder / FAILED})")
        state = State.UNFINISHED if info.state is State.FINISHED else info.state
        return cls(config.name, state)


def print_endings(
    endings: Sequence[Ending], labels: Mapping[str, str], console: Console | None = None
) -> int:
    """Print a table of all jobs and a line that counts them; return the sweep's exit code."""
    console = console or output()
    console.print(make_table(endings, labels))
    counts = Counter(ending.state for ending in endings)
    listed = ", ".join(f"{counts[state]} {state.value}" for state in State if counts[state])
    all_done = counts[State.FINISHED] == len(endings)
    more = "" if all_done else f"; {AGAIN}"
    console.print(f"{len(endings)} jobs: {listed}{more}", soft_wrap=True, highlight=False)
    return 0 if all_done else NOT_ALL


def make_table(endings: Sequence[Ending], labels: Mapping[str, str]) -> Table:
    """A row for each job, in the order of the sweep: its result, or why there is none."""
    table = Table(box=box.SIMPLE_HEAD)
    for title in ("job", "", "state", "result on its test houses"):
        table.add_column(title, overflow="fold")
    for ending in endings:
        result = result_of(ending.entries) if ending.entries else ending.reason
        cells = (ending.name, labels[ending.name], ending.state.value, result)
        table.add_row(*map(Text, cells))
    return table


def result_of(entries: Sequence[Entry]) -> str:
    """A job's own score with its interval, and as a multiple of the planner's."""
    own = entries[0]
    if "T_90" not in own["summary"]:
        return f"return {interval(own['summary']['return'])}"
    yardstick = next((e for e in entries if is_yardstick(e, own)), None)
    ratio = ratio_to(yardstick, own, "T_90")
    return f"T_90 {interval(own['summary']['T_90'])}, x {ratio}"
