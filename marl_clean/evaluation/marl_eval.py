"""`marl_eval.json`: a comparison in the format of marl-eval, environment, task, algorithm, run.

Source: github.com/instadeepai/marl-eval (id-marl-eval 0.0.4); Gorsane et al. (arXiv 2209.10485).

    {environment: {task: {algorithm: {run: {
        "step_0": {"step_count": frames, metric: [value]}, ...,
        "absolute_metrics": {metric: [one value a house]}}}}}}

Three environments. `marl_clean`: settings, a run for each seed, its steps from its validation in
training. `marl_clean_planners`: planners, which do not train: one step, of count 0.
`marl_clean_records`: everything that reading it back needs, of both, as numbers: `about.NAME` and
`about.NAME=TEXT` describe a run; a property of houses that is null somewhere has its other values
under its name, and under `known.NAME` where they stand; `text.NAME=TEXT` lists the houses that have
this text. A time not reached counts as `max_steps` in the first two. marl-eval itself needs as many
runs and steps of every algorithm, and no comma in a name: commas are written as semicolons.
"""

import json
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from marl_clean.errors import BadInput
from marl_clean.evaluation.measured import (
    MOST_VALUES,
    Measured,
    check_exported,
    entry_of,
    read_text,
    versions_fit,
)
from marl_clean.evaluation.records import MEASURES, House, means, sample
from marl_clean.storage.reading import parse_json

NAME = "marl_eval.json"
LEARNED, PLANNERS, RECORDS = "marl_clean", "marl_clean_planners", "marl_clean_records"
ABSOLUTE = "absolute_metrics"
TEXTS = ("world", "setting", "row", "policy", "house_set", "config_hash")
NUMBERS = ("seed", "parameters", "silent", "n_agents", "epsilon", "schema", "rules")
ENTRY = ("policy", "house_set", "config_hash", "epsilon", "n_agents")  # in the order of records

Series = Sequence[tuple[float, float]]  # (frames, value)
Tree = dict[str, Any]


def to_marl_eval(measured: Sequence[Measured], curves: Mapping[Path, Mapping[str, Series]]) -> str:
    """The text of marl_eval.json; `curves`: by run folder its validation measures over training."""
    tree: Tree = {LEARNED: {}, PLANNERS: {}, RECORDS: {}}
    for item in measured:
        houses = item.entry["houses"]
        learned = item.setting is not None
        curve = curves.get(item.folder, {}) if item.folder is not None else {}
        absolute = {
            name: [_shortest(value) for value in sample([houses], name)[0].tolist()]
            for name in MEASURES
            if name in houses[0] and not (curve and name not in curve)
        }
        absolute = {name: values for name, values in absolute.items() if _finite(values)}
        steps = _steps(curve, absolute) if learned else {"step_0": {"step_count": 0, **absolute}}
        environment = tree[LEARNED if learned else PLANNERS]
        _place(environment, item)[_run(item)] = {**steps, ABSOLUTE: absolute}
        summary = {name: [value] for name, value in means(houses).items() if name in MEASURES}
        records = {"step_0": {"step_count": 0, **summary}, ABSOLUTE: _record(item)}
        _place(tree[RECORDS], item)[_run(item)] = records
    kept = {name: tasks for name, tasks in tree.items() if tasks}
    return json.dumps(kept, separators=(",", ":"), allow_nan=False) + "\n"


def read_marl_eval(path: Path) -> list[Measured]:
    """What a marl_eval.json of ours holds; entries of another version are logged and left out.

    Raises BadInput where the file is none, or only the beginning of one.
    """
    content = read_text(path).encode("utf-8")
    try:
        tree = parse_json(content, MOST_VALUES)
    except ValueError as error:
        raise BadInput(f"{path}: is not JSON ({error}); half-written, or no export") from error
    if not isinstance(tree, dict) or not isinstance(tree.get(RECORDS), dict):
        raise BadInput(f"{path}: has no {RECORDS}; a {NAME} of `compare --export` is valid")
    result = []
    try:
        for task in tree[RECORDS].values():
            for algorithm in task.values():
                for run in algorithm.values():
                    item = _measured(path, run[ABSOLUTE])
                    result += [] if item is None else [item]
    except BadInput:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, StopIteration) as error:
        reason = reprlib.repr(str(error))
        raise BadInput(f"{path}: {RECORDS}: not as exported ({reason}); damaged?") from error
    check_exported(path, result)
    return result


def _steps(curve: Mapping[str, Series], absolute: Mapping[str, Any]) -> Tree:
    """A step for each frame at which every measure was validated."""
    by_frame: dict[float, Tree] = {}
    for name in absolute:
        for frames, value in curve.get(name, ()):
            by_frame.setdefault(frames, {})[name] = [value]
    whole = {
        frames: step for frames, step in sorted(by_frame.items()) if len(step) == len(absolute)
    }
    return {
        f"step_{place}": {"step_count": int(frames), **step}
        for place, (frames, step) in enumerate(whole.items())
    }


def _shortest(value: float) -> float | int:
    """A whole number without its `.0`: the same number of JSON, and most values are whole."""
    return int(value) if value.is_integer() else value


def _place(environment: Tree, item: Measured) -> Tree:
    """The runs of an entry's algorithm in its task."""
    entry = item.entry
    task = f"{entry['house_set']}, {entry['n_agents']} robots, {item.world}"
    algorithm = str(item.label).replace(",", ";")
    return environment.setdefault(task, {}).setdefault(algorithm, {})


def _run(item: Measured) -> str:
    return "planner" if item.seed is None else f"seed_{item.seed}"


def _finite(values: Sequence[float]) -> bool:
    return all(value == value for value in values)


def _record(item: Measured) -> Tree:
    """Everything about an entry and its houses, as lists of numbers."""
    about = {
        **{name: item.entry[name] for name in (*ENTRY, "schema")},
        **{"world": item.world, "setting": item.setting, "row": item.label, "seed": item.seed},
        **{"parameters": item.parameters, "silent": int(item.silent)},
        "rules": item.entry["world"],
    }
    record: Tree = {}
    for name in TEXTS:
        if about[name] is not None:
            record[f"about.{name}={about[name]}"] = [1]
    record |= {f"about.{name}": [about[name]] for name in NUMBERS if about[name] is not None}
    houses: Sequence[House] = item.entry["houses"]
    for name in houses[0]:
        values = [house[name] for house in houses]
        texts = [value for value in values if isinstance(value, str)]
        for text in dict.fromkeys(texts):
            record[f"text.{name}={text}"] = [i for i, value in enumerate(values) if value == text]
        if texts:
            continue
        record[name] = [value for value in values if value is not None]
        if None in values:
            record[f"known.{name}"] = [int(value is not None) for value in values]
    return record


def _measured(path: Path, record: Tree) -> Measured | None:
    """An entry from its record; None where it is of another version."""
    about: dict[str, Any] = {name: record.get(f"about.{name}", [None])[0] for name in NUMBERS}
    columns: dict[str, dict[int, Any]] = {}  # of each property the value by house
    for key, values in record.items():
        kind, _, rest = key.partition(".")
        name, _, text = rest.partition("=")
        if kind == "about" and name in TEXTS:
            about[name] = text
        elif kind == "text":
            columns.setdefault(name, {}).update(dict.fromkeys(values, text))
        elif kind not in ("about", "known"):
            known = record.get(f"known.{key}", [1] * len(values))
            left = iter(values)
            columns[key] = {i: next(left) if here else None for i, here in enumerate(known)}
    if not versions_fit(path, about["policy"], about["schema"], about["rules"]):
        return None
    number = max(map(len, columns.values()))
    houses = [{name: column[i] for name, column in columns.items()} for i in range(number)]
    fields = {"schema": about["schema"], "world": about["rules"]}
    fields |= {name: about[name] for name in ENTRY}
    return Measured(
        about["world"],
        about.get("setting"),
        about["seed"],
        entry_of(path, fields, houses),
        about["row"],
        bool(about["silent"]),
        about["parameters"],
    )
