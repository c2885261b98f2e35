"""Store a table from what was measured:

    python -m tests.results.store NAME --about TEXT --command TEXT LABEL=FILE,FILE ...

A LABEL is a row's name, its FILEs are the evaluation.json of its seeds, each with the row's own
entry first; several files may also be of one seed in different places. Planners are taken from the
first file that has them, with their own names. `--places A,B` leaves out other places,
`--not-stored ROW` names a row of the page without a record.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_clean.evaluation.records import Entry, read_entries
from tests.results.stored import entry_of, place_of, write


def main(argv: Sequence[str] | None = None) -> None:
    """Read the files, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.results.store")
    parser.add_argument("name")
    parser.add_argument("rows", nargs="+", metavar="LABEL=FILE,FILE")
    parser.add_argument("--about", required=True)
    parser.add_argument("--command", action="append", required=True)
    parser.add_argument("--not-stored", action="append", default=[])
    parser.add_argument("--places", type=lambda text: text.split(","))
    arguments = parser.parse_args(argv)
    files = {
        label: [Path(file) for file in names.split(",")]
        for label, _, names in (row.rpartition("=") for row in arguments.rows)
    }
    entries = list(stored(files, arguments.places))
    about, commands, missing = arguments.about, arguments.command, arguments.not_stored
    print(write(arguments.name, about, commands, entries, missing))


def stored(
    files: Mapping[str, Sequence[Path]], places: Sequence[str] | None = None
) -> Iterator[dict[str, Any]]:
    """The table's entries: those of each row, and the planners'."""
    planners: dict[tuple[str, str, int], dict[str, Any]] = {}
    for label, seeds in files.items():
        own: dict[tuple[str, int], list[Entry]] = {}
        for file in seeds:
            first, *_ = measured = read_entries(file)
            for entry in measured:
                key = place_of(entry), entry["n_agents"]
                if places is not None and key[0] not in places:
                    continue
                if entry["policy"] == first["policy"]:
                    own.setdefault(key, []).append(entry)
                elif (entry["policy"], *key) not in planners:
                    planners[(entry["policy"], *key)] = entry_of(entry["policy"], [entry])
        yield from (entry_of(label, runs) for runs in own.values())
    yield from planners.values()


if __name__ == "__main__":
    main()
