"""Planners that are nearly right do not hold the contract."""

import pytest

from marl_clean.planner.base import Planner
from marl_clean.testing import ContractBroken, check_planner
from tests.families import family


class SeesWhatIsClean(Planner):
    """Acts by how much of the house is clean, which no robot knows."""

    label = "wrong"

    def act(self):
        return (self.random_action() + self.env.state.num_visited[:, None]) % 4


class OutOfRange(SeesWhatIsClean):
    def act(self):
        return self.random_action() + 1


class OverWorlds(SeesWhatIsClean):
    def act(self):
        return (self.random_action() + self.env.state.position.sum()) % 4


class Impatient(SeesWhatIsClean):
    """Is another when it is asked twice."""

    def act(self):
        self.asked = not getattr(self, "asked", False)
        return (self.random_action() + self.asked) % 4


class Nameless(SeesWhatIsClean):
    label = "one\nand another"


@family(
    ("wrong", "broken"),
    [
        (SeesWhatIsClean, "reads what no robot knows: step 0, env.sensor=bump"),
        (OutOfRange, "actions from 1 to 4; valid: 0 to 3"),
        (OverWorlds, "it acts differently alone: at"),
        (Impatient, "differs when called twice in step 0: at"),
        (Nameless, "not one short line"),
    ],
    fast=2,
)
def test_the_contract_refuses(wrong: type[Planner], broken: str) -> None:
    with pytest.raises(ContractBroken, match=f"^planner={wrong.__name__}: .*{broken}"):
        check_planner(wrong)


@pytest.mark.slow
def test_a_planner_that_does_not_finish_breaks_the_contract() -> None:
    with pytest.raises(ContractBroken, match="planner=random: .* houses .* are not finished"):
        check_planner("random")
