"""A few mutations of each format; `tests.reliability.mutations` tries thousands."""

import json
import os
import signal
from collections.abc import Callable
from typing import Any

import pytest
import yaml

from marl_clean.commands import run_record
from marl_clean.errors import BadInput
from marl_clean.evaluation import tidy
from marl_clean.storage import safe_yaml
from tests.families import family
from tests.reliability import mutations, mutators
from tests.reliability.formats import FORMATS
from tests.reliability.mutations import attempt, in_child, run

pytestmark = pytest.mark.usefixtures("unchecked")


@family("name", FORMATS, fast=[], usual=5)
def test_a_mutated_file_is_read_or_refused_in_one_short_line(name: str) -> None:
    counted = run(name, trials=20)
    assert counted.faults == [] and counted.read + counted.refused == 20


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "module", "check", "defect", "number", "fault"),
    [
        # NaN, infinity, and as deep as brackets go.
        ("run.json", run_record, "parse_json", json.loads, "NaN", "ValueError"),
        ("run.json", run_record, "parse_json", json.loads, "[" * 5000, "RecursionError"),
        # Dates, which no setting is.
        ("config.yaml", safe_yaml, "Plain", yaml.SafeLoader, "2020-01-01", "TypeError"),
        # Cells that hold any JSON.
        ("tidy.csv", tidy, "_number", json.loads, "[" * 5000, "RecursionError"),
    ],
)
def test_a_reader_without_its_limits_is_caught(
    name: str,
    module: Any,
    check: str,
    defect: Any,
    number: str,
    fault: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, check, defect)
    monkeypatch.setattr(mutators, "NUMBERS", (number,))
    for kinds in ("OF_BYTES", "OF_TEXT"):
        monkeypatch.setattr(mutators, kinds, (mutators.renumber,))
    faults = run(name, trials=40).faults
    assert any(fault in line for line in faults), faults


def compute() -> None:
    for _ in range(2000):
        sum(range(1000))


def say_two_lines() -> None:
    error = BadInput("a")
    error.args = ("a\nb",)
    raise error


@pytest.mark.parametrize(
    ("read", "fault"),
    [
        (lambda: json.loads("{}")["a"], "KeyError"),
        (say_two_lines, "no short line"),
        (lambda: b"a" * (320 << 20), "took 3"),
        (compute, "took 0"),
        (lambda: os._exit(1), "a child ended"),
    ],
)
def test_what_no_reader_may_do_is_a_fault(
    read: Callable[[], object], fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutations, "MOST_SECONDS", 0.01 if read is compute else 60)
    [line] = in_child(lambda: attempt(read)).faults
    assert line.startswith(fault)


def test_a_reader_that_never_ends_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mutations, "HANG_SECONDS", 1)
    [line] = in_child(lambda: attempt(signal.pause)).faults
    assert line.startswith("a child ended")
