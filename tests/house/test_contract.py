"""Every level of conf/house holds the contract, and houses that are nearly right do not."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from marl_clean.config.levels import rooms
from marl_clean.house.base import House, HouseLayout
from marl_clean.testing import ContractBroken, check_house
from tests.families import family

FILES = {"floorplan": {"path": "apartment"}}


@family("level", rooms()["house"], fast=2)
def test_the_contract(level: str) -> None:
    check_house(level, **FILES.get(level, {}))


class Right(House):
    """A square room, furnished in one corner, as large as its seed says."""

    generated: ClassVar[bool] = True

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        furniture = np.zeros((4 + seed % 3, 4), np.int16)
        furniture[0, 0] = 1
        return HouseLayout(furniture == 0, furniture, None, seed)


class GlobalNumbers(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        layout = super().layout(seed, draw)
        return replace(layout, free=layout.free & (np.random.random(layout.free.shape) < 0.9))


class ByOrder(Right):
    asked = 0

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        ByOrder.asked += 1
        return super().layout(seed + ByOrder.asked, draw)


class OtherSource(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        return super().layout(seed + 1, draw)


class OnTheFloor(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        layout = super().layout(seed, draw)
        return replace(layout, furniture=layout.furniture + np.int16(1))


class Numbers(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        layout = super().layout(seed, draw)
        return replace(layout, free=layout.free.astype(np.int64))


class InTheWall(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        return replace(super().layout(seed, draw), starts=((0, 0),))


class Parted(Right):
    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        layout = super().layout(seed, draw)
        free = layout.free.copy()
        free[1] = False
        return replace(layout, free=free)


@dataclass(frozen=True)
class Changing(House):
    """From a file, and yet another layout for another seed."""

    generated: ClassVar[bool] = False

    def layout(self, seed: int, draw: int = 0) -> HouseLayout:
        return replace(Right().layout(seed), source="drawn.txt")


@pytest.mark.parametrize(
    ("wrong", "broken"),
    [
        (GlobalNumbers, r"layout\(.*\) differs when drawn again"),
        (ByOrder, r"not the seed"),
        (OtherSource, r"layout\(0, draw=0\).source is 1, not the seed"),
        (OnTheFloor, r"\(row, col\) \[\[0, 1\]\] is free and furniture"),
        (Numbers, r"int64 \[4, 4\], not bool"),
        (InTheWall, r"start \(0, 0\) is no free cell"),
        (Parted, "in 100 draws of seed 0"),
        (Changing, r"layout\(2000000, draw=7\) differs when drawn again"),
    ],
)
def test_the_contract_refuses(wrong: type[House], broken: str) -> None:
    check_house(Right)
    with pytest.raises(ContractBroken, match=f"house={wrong.__name__}: .*{broken}"):
        check_house(wrong)
