"""What a row gains over its silent twin: recovered headroom, and seeds that form a protocol.

A seed forms a protocol in a measure when, house by house over the same houses,

    silent - arm > 0    and    zeroed - arm > 0    and not    silent - zeroed > 0

each clearly: the 95 % interval over houses lies above 0. It beats the silent run of its seed, its
message is heard, and without the message the gain is gone.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from rich import box
from rich.table import Table
from scipy.special import betaincinv  # scipy.stats has the interval too, and takes a second

from marl_clean.evaluation.paired import Row, common_seeds, values
from marl_clean.evaluation.ratios import recovered_headroom
from marl_clean.evaluation.records import Entry
from marl_clean.evaluation.resampling import Interval
from marl_clean.evaluation.statistics import paired_difference

MEASURES = ("T_90", "T_100")
PROTOCOL = MEASURES[0]
NONE = "-"
NO_GAP = "no headroom"
LEVEL = 0.95
CAPTION = (
    "Recovered: (S - row) / (S - O), S: {silent}, O: {oracle}, over the seeds that all have.\n"
    "no headroom: S - O is not clearly above 0, so there is nothing to share. Protocols: seeds\n"
    "that beat their silent twin in T_90, are heard, and lose the gain with messages zeroed.\n"
    "Brackets: 95 % intervals."
)


def recovered_of(row: Row, silent: Row, oracle: Row) -> dict[str, Any]:
    """Which share of silent - oracle a row recovers, over the seeds that all three have.

    `silent`, `oracle`, `seeds`, and of each time `{"value", "ci95", "gap": {"value", "ci95"}}`: the
    value is null where the gap is not clearly above 0, and where no seed is common.
    """
    seeds = sorted({*common_seeds(row, silent)} & {*common_seeds(row, oracle)})
    result: dict[str, Any] = {"silent": silent.label, "oracle": oracle.label, "seeds": seeds}
    if not seeds and not all(None in side.runs for side in (row, silent, oracle)):
        return result | {name: {**_number(Interval(None, None)), "gap": None} for name in MEASURES}
    for measure in MEASURES:
        start, own, end = (values(side, seeds, measure) for side in (silent, row, oracle))
        recovered = recovered_headroom(start, own, end)
        result[measure] = {**_number(recovered.share), "gap": _number(recovered.gap)}
    return result


def protocols_of(row: Row, silent: Row, zeroed: Mapping[int, Entry]) -> dict[str, Any]:
    """The share of a row's seeds that form a protocol, with its exact 95 % interval.

    `zeroed`: the entries of its runs with their messages zeroed, by seed. `silent`, `measure`,
    `seeds` (that have a silent twin and were zeroed), `formed` (of these), `value`, `ci95`.
    """
    seeds = [seed for seed in common_seeds(row, silent) if seed in zeroed]
    without = Row(f"{row.label}, zeroed", dict(zeroed))
    formed = [seed for seed in seeds if forms_protocol(*_sides(seed, silent, row, without))]
    share = Interval(None, None)
    if seeds:
        share = Interval(len(formed) / len(seeds), clopper_pearson(len(formed), len(seeds)))
    head = {"silent": silent.label, "measure": PROTOCOL, "seeds": seeds, "formed": formed}
    return {**head, **_number(share)}


def forms_protocol(
    silent: Float[np.ndarray, "1 house"],
    arm: Float[np.ndarray, "1 house"],
    zeroed: Float[np.ndarray, "1 house"],
) -> bool:
    """Whether one seed's times in the same houses show a protocol, see this module."""
    gains, is_heard = is_longer(silent, arm), is_longer(zeroed, arm)
    return gains and is_heard and not is_longer(silent, zeroed)


def is_longer(values: Float[np.ndarray, "1 house"], than: Float[np.ndarray, "1 house"]) -> bool:
    """Whether the interval of the paired difference over houses lies above 0."""
    difference = paired_difference(values, than)
    return difference.ci95 is not None and difference.ci95[0] > 0


def clopper_pearson(successes: int, trials: int) -> tuple[float, float]:
    """The exact 95 % interval of a probability (C. Clopper and E. Pearson, 1934).

    Its ends are quantiles of beta distributions; with all or no successes one end is 1 or 0.
    """
    tail, failures = (1 - LEVEL) / 2, trials - successes
    low = betaincinv(successes, failures + 1, tail) if successes else 0.0
    high = betaincinv(successes + 1, failures, 1 - tail) if failures else 1.0
    return float(low), float(high)


def _sides(seed: int, *rows: Row) -> tuple[Float[np.ndarray, "1 house"], ...]:
    return tuple(values(row, [seed], PROTOCOL) for row in rows)


def _number(number: Interval) -> dict[str, Any]:
    return {"value": number.value, "ci95": None if number.ci95 is None else list(number.ci95)}


def make_gains_table(statistics: Sequence[Mapping[str, Any]]) -> Table | None:
    """IQM, probability of improvement and gains side by side; None where no row has gains."""
    titles, *gains = gain_cells(statistics)
    if not titles:
        return None
    recovered: Mapping[str, Any] = next(
        (row["recovered"] for row in statistics if "recovered" in row), {}
    )
    names = {name: recovered.get(name, "none given") for name in ("silent", "oracle")}
    table = Table(
        title=f"gains over silence ({statistics[0]['house_set']})",
        caption=CAPTION.format(**names),
        caption_justify="left",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("policy", no_wrap=True)
    overs = any("improvement" in row for row in statistics)
    for title in ("seeds", f"IQM {PROTOCOL}", *(["P(sooner)"] if overs else []), *titles):
        table.add_column(title, justify="right", no_wrap=True)
    for row, cells in zip(statistics, gains, strict=True):
        middle = row["aggregates"][PROTOCOL]["iqm"]
        line = [row["row"], str(len(row["seeds"])) if row["seeds"] else NONE, _cell(middle, 1)]
        line += [_cell(row.get("improvement", {}).get(PROTOCOL), 2)] if overs else []
        table.add_row(*line, *cells)
    return table


def _cell(number: Mapping[str, Any] | None, digits: int) -> str:
    if number is None or number["value"] is None:
        return NONE
    low, high = (f"{end:.{digits}f}" for end in number["ci95"])
    return f"{number['value']:.{digits}f} [{low}, {high}]"


def gain_cells(statistics: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The columns of gains, titles first: none where no row has any."""
    kinds = [kind for kind in ("recovered", "protocols") if any(kind in row for row in statistics)]
    titles = {
        "recovered": [f"recovered {measure}" for measure in MEASURES],
        "protocols": ["protocols"],
    }
    lines = [[title for kind in kinds for title in titles[kind]]]
    for row in statistics:
        cells: list[str] = []
        for kind in kinds:
            if kind not in row:
                cells += [NONE] * len(titles[kind])
            elif kind == "recovered":
                cells += [_recovered_cell(row[kind][measure]) for measure in MEASURES]
            else:
                cells.append(_protocol_cell(row[kind]))
        lines.append(cells)
    return lines


def _recovered_cell(number: Mapping[str, Any]) -> str:
    if number["value"] is None:
        return NONE if number["gap"] is None or number["gap"]["value"] is None else NO_GAP
    return _cell(number, 2)


def _protocol_cell(share: Mapping[str, Any]) -> str:
    if share["value"] is None:
        return NONE
    low, high = share["ci95"]
    return f"{len(share['formed'])} of {len(share['seeds'])} [{low:.2f}, {high:.2f}]"
