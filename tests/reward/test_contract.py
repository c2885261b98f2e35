"""Every level of conf/reward holds the contract, and splits that are nearly right do not."""

import pytest

from marl_clean.config.levels import rooms
from marl_clean.reward.individual import Individual
from marl_clean.testing import ContractBroken, check_reward


@pytest.mark.parametrize("level", rooms()["reward"])
def test_the_contract(level: str) -> None:
    check_reward(level)


def planted(pay) -> type:
    return type("Planted", (Individual.__base__,), {"pay": pay})


def by_number(self, own_reward, adjacency):
    paid = own_reward.clone()
    paid[..., 0, :] = 0
    return paid


def in_place(self, own_reward, adjacency):
    return own_reward.mul_(2).clone()


@pytest.mark.parametrize(
    ("pay", "broken"),
    [
        (by_number, "are paid differently: at"),
        (in_place, "changes the own rewards in place: at"),
        (lambda self, own, live: own, "returns its input"),
        (lambda self, own, live: own - own.mean(), "is paid differently alone: at"),
        (lambda self, own, live: own / own.abs().min() / 0, "is not finite"),
        (lambda self, own, live: own.squeeze(-1) + 0, "pay gives torch.float32"),
    ],
)
def test_the_contract_refuses(pay, broken: str) -> None:
    check_reward(planted(lambda self, own, live: 2 * own))
    with pytest.raises(ContractBroken, match=f"reward=Planted: .*{broken}"):
        check_reward(planted(pay))
