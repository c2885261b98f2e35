"""The tables of what talking costs, put together from times that were made up."""

from io import StringIO

import pytest
import torch
from rich.console import Console

from marl_clean.commands import _benchmark_schemes as schemes
from marl_clean.commands._benchmark_schemes import Cost, exponent, prepared, ratios
from marl_clean.commands.benchmark import table_of_costs, table_of_growth

COSTS = [Cost("comm=none", 10.0, 2.0, 1_000), Cost("comm=dgn", 15.0, 3.0, 2_500)]


def shown(table) -> str:
    console = Console(width=120, file=StringIO())
    console.print(table)
    return console.file.getvalue()


def test_costs_are_multiples_of_the_first() -> None:
    assert [(update, step) for _, update, step in ratios(COSTS)] == [(1.0, 1.0), (1.5, 1.5)]
    row = next(line for line in shown(table_of_costs(COSTS)).splitlines() if "comm=dgn" in line)
    assert all(text in row for text in ("2,500", "15.00", "1.50", "3.00"))


def test_growth_is_a_power_of_the_number_of_robots() -> None:
    squared = {n: 0.5 * n**2 for n in schemes.TEAMS}
    assert exponent(squared) == pytest.approx(2.0)
    text = shown(table_of_growth({"plan": squared}))
    assert "n^2.0" in text and "n=64" in text


def test_every_case_is_timed_and_the_first_is_what_others_are_held_against(monkeypatch) -> None:
    monkeypatch.setattr(schemes, "prepared", lambda settings: (int, int, Agent()))
    scheme, channel = schemes.costs_of_schemes(), schemes.costs_of_channels()
    assert scheme[0].what == "comm=none" and len(scheme) == len(schemes.rooms()["comm"])
    assert channel[0].what == "channel=perfect" and len(channel) == len(schemes.rooms()["channel"])
    assert all(cost.parameters == 6 for cost in scheme)


class Agent:
    """As much of one as is counted."""

    network = torch.nn.Linear(2, 2)


@pytest.mark.slow
@pytest.mark.parametrize("settings", [["comm=plan"], ["channel=delayed"]])
def test_an_update_and_a_step_run(settings: list[str]) -> None:
    update, step, agent = prepared(settings)
    before = [weight.clone() for weight in agent.network.parameters()]
    update()
    step()
    after = agent.network.parameters()
    assert not all(torch.equal(mine, theirs) for mine, theirs in zip(before, after, strict=True))
