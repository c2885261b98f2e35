"""Env i of many is env i alone whatever is drawn, and a seed says all; what breaks it is caught."""

import itertools
from collections.abc import Sequence

import pytest
import torch

from marl_clean.env import cleaning
from tests.families import family
from tests.reliability import determinism

STEPS = 20
pytestmark = pytest.mark.usefixtures("one_thread", "unchecked")


@family("reading", determinism.READINGS, fast=[], usual=1)
def test_env_i_of_many_is_env_i_alone(reading: str) -> None:
    assert determinism.difference(determinism.READINGS[reading], STEPS) is None


@pytest.mark.slow
def test_a_draw_from_the_global_generator_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def global_draw(state, env_index, seed, probability):
        return torch.rand(state.position.shape[:-1]) < probability

    monkeypatch.setattr(cleaning, "unnoticed_bumps", global_draw)
    where = determinism.difference(determinism.READINGS["private"], STEPS)
    assert where is not None and "differs" in where


@pytest.mark.long
def test_two_processes_with_one_seed_end_alike_and_another_seed_does_not() -> None:
    assert determinism.compared(["iql:0:1", "iql:1:1"]) == []


def test_a_process_that_draws_for_itself_and_a_seed_without_effect_are_caught(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    processes = itertools.count()

    def of_the_process(jobs: Sequence[str]) -> dict[str, str]:
        process = next(processes)
        return {job: f"{job} {process}" for job in jobs}

    jobs = ["iql:0:1", "iql:1:1"]
    monkeypatch.setattr(determinism, "in_a_process", of_the_process)
    assert determinism.compared(jobs) == [f"{job}: two processes differ" for job in jobs]
    monkeypatch.setattr(determinism, "in_a_process", lambda jobs: dict.fromkeys(jobs, "weights"))
    assert determinism.compared(jobs) == ["iql:1: other seeds, the same run"]
