"""`marl-clean watch`: one episode in a held-out house, shown in the terminal."""

import sys
import time
from collections.abc import Callable

from omegaconf import DictConfig

from marl_clean.commands._plan_lines import write_plan_lines
from marl_clean.env.viewer import draw_text
from marl_clean.report.episode import first_held_out, policy_of, scenes

FRAMES_PER_SECOND = 8.0
HOME, CLEAR, CLEAR_LINE, CLEAR_BELOW = "\x1b[H", "\x1b[2J", "\x1b[K", "\x1b[J"
HIDE_CURSOR, SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"


def main(
    cfg: DictConfig,
    frames_per_second: float = FRAMES_PER_SECOND,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show an episode in the first held-out house with `cfg.checkpoint`'s policy or `cfg.planner`.

    A file or a pipe gets the last frame alone, as plain text and without delay.
    """
    write_plan_lines(cfg)
    out = sys.stdout
    episode = scenes(first_held_out(cfg), policy_of(cfg))
    if not out.isatty():
        *_, last = episode
        out.write(draw_text(last, colour=False) + "\n")
        return
    out.write(HIDE_CURSOR + CLEAR)
    try:
        for scene in episode:
            # Written over the previous frame, line by line: clearing it first would flicker.
            frame = draw_text(scene).replace("\n", f"{CLEAR_LINE}\n")
            out.write(f"{HOME}{frame}{CLEAR_LINE}\n{CLEAR_BELOW}")
            out.flush()
            sleep(1 / frames_per_second)
    finally:
        out.write(SHOW_CURSOR)
        out.flush()
