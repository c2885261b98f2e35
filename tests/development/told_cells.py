"""What is read in the messages of a run with `comm=autoencoder`, beside what the senders know:

    python -m tests.development.told_cells RUN

Of the cells around senders that are heard, in the first 50 test houses while their robots clean:
which share is told as what it is, and which share of what is told of a kind is something else.
"""

import sys
from pathlib import Path

import torch
from torch import Tensor

from marl_clean import build, keys
from marl_clean.config.compose import checked
from marl_clean.config.stored import find_run, load_config
from marl_clean.evaluation.rollouts import first_frame, rollout_episodes
from marl_clean.settings import HouseOrder
from marl_clean.world.patches import BLOCKED, CLEANED, NUM_CLASSES

HOUSES = 50
SHOWN = {"walls": BLOCKED, "cleaned": CLEANED}


def counted(run: Path) -> Tensor:
    """How many cells of each kind were told as which: [kind, told]."""
    cfg = checked(load_config(run))
    houses = build.held_out_houses(cfg, "test", HOUSES)
    env = build.make_env(
        cfg, houses, num_envs=HOUSES, house_order=HouseOrder.FIXED, never_stuck=True, shaped=False
    )
    policy, pairs = build.load_policy(run), torch.zeros(NUM_CLASSES**2)
    ended = torch.zeros(HOUSES, dtype=torch.bool)
    for step in rollout_episodes(env, policy, first_frame(env, policy)):
        heard = step[keys.TOLD_EDGES].any(-2) & ~ended[:, None]
        kind, told = (step[key][heard].flatten().long() for key in (keys.PATCH, keys.TOLD_PATCH))
        pairs += torch.bincount(kind * NUM_CLASSES + told, minlength=NUM_CLASSES**2)
        ended |= step["next", keys.DONE][:, 0]
    return pairs.view(NUM_CLASSES, NUM_CLASSES)


def main(name: str) -> None:
    """Print a line for walls and one for cleaned cells."""
    pairs = counted(find_run(name))
    for title, kind in SHOWN.items():
        right = pairs[kind, kind]
        known, told = pairs[kind].sum(), pairs[:, kind].sum()
        print(f"{title}: {right / known:.1%} told, {1 - right / told:.1%} of what is told is wrong")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(*sys.argv[1:])
