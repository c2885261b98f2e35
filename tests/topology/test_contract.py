"""Every level of conf/topology holds the contract, and topologies that are nearly right do not."""

import pytest
import torch

from marl_clean.config.levels import rooms
from marl_clean.testing import ContractBroken, check_topology
from marl_clean.topology.base import Topology
from tests.families import family


@family("level", rooms()["topology"], fast=2)
def test_the_contract(level: str) -> None:
    check_topology(level)


class Right(Topology):
    """In one row, or in one column."""

    def contact(self, state, rules):
        same = (state.position[:, :, None] == state.position[:, None]).any(-1)
        return same & ~torch.eye(state.n_agents, dtype=torch.bool)


class OneWay(Right):
    def contact(self, state, rules):
        row = state.position[..., 0]
        return row[:, :, None] < row[:, None]


class WithItself(Right):
    def contact(self, state, rules):
        return super().contact(state, rules) | torch.eye(state.n_agents, dtype=torch.bool)


class ByNumber(Right):
    def contact(self, state, rules):
        contact = torch.zeros_like(super().contact(state, rules))
        contact[:, 0, 1] = contact[:, 1, 0] = True
        return contact


class ByTheOthers(Right):
    def contact(self, state, rules):
        busy = state.step.max() % 2 == state.position[..., 0].sum() % 2
        return super().contact(state, rules) & busy


class Moving(Right):
    def contact(self, state, rules):
        contact = super().contact(state, rules)
        state.visited.logical_not_()
        return contact


class Numbers(Right):
    def contact(self, state, rules):
        return super().contact(state, rules).long()


class OneWayAmong(Right):
    def among(self, n_agents):
        return torch.ones(n_agents, n_agents, dtype=torch.bool).triu(1)


@family(
    ("wrong", "broken"),
    [
        (OneWay, "not mutual at"),
        (WithItself, "in contact with itself at"),
        (ByNumber, r"renumbered as \[2, 0, 1\] have other contacts: at"),
        (ByTheOthers, "has other contacts alone: at"),
        (Moving, "contact changes the worlds' visited: at"),
        (Numbers, "bool"),
        (OneWayAmong, r"among\(2\): contact is not mutual"),
    ],
    fast=2,
)
def test_the_contract_refuses(wrong: type[Topology], broken: str) -> None:
    check_topology(Right)
    with pytest.raises(ContractBroken, match=f"topology={wrong.__name__}: .*{broken}"):
        check_topology(wrong)
