"""What a communication scheme and its settings ask of the env: transforms, and an exchange."""

from collections.abc import Callable, Mapping
from typing import Any

from marl_clean.env.known_cells import KnownCells
from marl_clean.env.offsets import Offsets
from marl_clean.env.own_patch import OwnPatch
from marl_clean.env.targets import Targets
from marl_clean.env.transform import WorldTransform
from marl_clean.errors import BadInput
from marl_clean.world.exchange import Exchange
from marl_clean.world.lending import Lending
from marl_clean.world.patches import REACH_CELLS, Patches
from marl_clean.world.setup import Telling

READABLE: Mapping[str, Callable[[], WorldTransform]] = {"target": Targets, "patch": OwnPatch}
"""What adds the entries that a scheme may name in `reads`."""


def asked_of_env(
    comm: Mapping[str, Any], reads: str | None, learning: bool
) -> list[WorldTransform]:
    """Return what adds the entries that a section `comm` of a config asks for.

    Args:
        comm: the section.
        reads: the entry that its class sends, if any.
        learning: those too that only losses take, from which messages are learnt.

    Raises:
        BadInput: no such entry.
    """
    sender_map, missing = (learning and asks for asks in _grounds(comm))
    transforms: list[WorldTransform] = []
    if comm.get("places", False) or missing:
        transforms.append(Offsets())
    if reads is not None:
        if reads not in READABLE:
            scheme = comm["_target_"]
            raise BadInput(f"{scheme}.reads={reads}: no such entry; valid: {', '.join(READABLE)}")
        transforms.append(READABLE[reads]())
    if sender_map or missing:
        transforms.append(KnownCells(sender_map, missing))
    return transforms


def reach_cells(comm: Mapping[str, Any], exchanges: str | None) -> int:
    """Return how many cells around the house these transforms read, or what robots exchange."""
    return REACH_CELLS if any(_grounds(comm)) or exchanges in ("patches", "codes") else 0


def exchange_of(comm: Mapping[str, Any], exchanges: str | None) -> Telling | None:
    """Return what the robots of a scheme tell each other of their maps; None: nothing.

    `exchanges`: in which form, as its class says.

    Raises:
        BadInput: no such form.
    """
    match exchanges:
        case "cells":
            return Exchange(comm["cells"])
        case "maps":
            return Lending()
        case "patches":
            return Patches(coded=False, tells=comm["tells"])
        case "codes":
            return Patches(coded=True)
        case None:
            return None
    valid = "cells, maps, patches, codes"
    raise BadInput(f"{comm['_target_']}.exchanges={exchanges}: no such form; valid: {valid}")


def _grounds(comm: Mapping[str, Any]) -> tuple[bool, bool]:
    ground = comm.get("ground", {})
    return ground.get("sender_map", 0) > 0, ground.get("missing", 0) > 0
