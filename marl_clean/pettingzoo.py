"""The cleaning world as a PettingZoo environment, for learners from elsewhere.

>>> from marl_clean import pettingzoo
>>> env = pettingzoo.parallel_env(n_agents=3, house="open", action_masks=True)
>>> observations, infos = env.reset(seed=0)
>>> sorted(observations), sorted(observations["robot_0"])
(['robot_0', 'robot_1', 'robot_2'], ['action_mask', 'observation'])
"""

import sys
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torchrl.envs.utils import step_mdp

from marl_clean import build, keys
from marl_clean.config.schema import choices
from marl_clean.env.cleaning import CleaningEnv
from marl_clean.env.specs import terms_of
from marl_clean.env.viewer import draw_text
from marl_clean.errors import BadInput
from marl_clean.python.keywords import Settings, overrides_of
from marl_clean.python.measuring import config_for_policy
from marl_clean.world.dynamics import MOVES
from marl_clean.world.rules import BLOCKED_VALUE, ROBOT_VALUE
from marl_clean.world.sensing import not_known_blocked
from marl_clean.world.shared_map import map_value, union_of_maps

try:
    from gymnasium.spaces import Box, Dict, Discrete, MultiBinary
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"marl_clean.pettingzoo needs {error.name}: pip install 'marl-clean[pettingzoo]'"
    ) from None

RENDER_MODES = ("human", "rgb_array", "ansi")


Seen = np.ndarray | dict[str, np.ndarray]
"""What one robot sees: an array, or a dict where there is more than its observation."""


class ParallelCleaning(ParallelEnv[str, Seen, int]):
    """Blind robots that clean an unknown house together; one world of `CleaningEnv`.

    ## Agents
    `robot_0`, `robot_1`, ...: all act in every step, from the first to the last.

    ## Actions
    Discrete(4): 0 up (row - 1), 1 right (col + 1), 2 down (row + 1), 3 left (col - 1).

    ## Observations
    Box: the config's `observation` of one robot. With `adjacency=True` or `action_masks=True` a
    Dict, which holds it as `observation`, and, where requested, `adjacency`, a row of n with 1 for
    every robot in contact, and `action_mask`, 1 for every action that leads into no wall known to
    the robot's own map (all 1 where all four are known walls).

    ## Rewards
    What the robot is paid by the config's `reward`. Infos hold the terms it earned itself, `step`,
    `cleaning`, `discovery`, `collision` where collisions pay, with spills `spill`, and their sum
    `own_reward`; they are 0 after a reset.

    ## Starting state
    Everything drawn is a pure function of (seed, episode): `reset(seed=s)` begins episode 0 of
    s, `reset()` the next episode of the same seed, at first of the config's.

    ## Episode end
    `terminated`: every free cell has been cleaned. `truncated`: `max_steps`, or stuck. For all
    robots at once; `agents` is empty then.

    ## References
    The rules are those of `marl_clean.world`; step for step this is the world of
    `marl_clean.make_env` with `env.num_envs=1`.

    ## Version history
    v0: world version 0.

    Raises:
        BadInput: a wrong setting, seed or action, a step before a reset or after the end.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "marl_clean_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": 8,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        settings: Settings = None,
        adjacency: bool = False,
        action_masks: bool = False,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise BadInput(f"render_mode={render_mode}: {choices(str(render_mode), RENDER_MODES)}")
        self.render_mode = render_mode
        self.shows_adjacency, self.shows_mask = adjacency, action_masks
        cfg = config_for_policy(overrides_of(settings, keywords))
        self.batched = build.make_env(cfg, num_envs=1)
        self.world: CleaningEnv = self.batched.base_env
        n_agents = self.world.n_agents
        self.possible_agents = [f"robot_{index}" for index in range(n_agents)]
        self.agents: list[str] = []
        box = self.batched.observation_spec[keys.OBSERVATION].space
        low, high = (bound[0, 0].cpu().numpy() for bound in (box.low, box.high))
        extras = {"adjacency": MultiBinary(n_agents)} if adjacency else {}
        extras |= {"action_mask": MultiBinary(len(MOVES))} if action_masks else {}

        def space() -> Box | Dict:
            seen = Box(low, high, dtype=np.float32)
            return Dict({"observation": seen, **extras}) if extras else seen

        # One each: sampling must not draw from another robot's stream.
        self.observation_spaces = {agent: space() for agent in self.possible_agents}
        self.action_spaces = {agent: Discrete(len(MOVES)) for agent in self.possible_agents}
        sides = self.world.houses.free.shape[1:]  # of the largest house
        self.state_space = Box(BLOCKED_VALUE, ROBOT_VALUE, sides, np.float32)

    def observation_space(self, agent: str) -> Box | Dict:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Discrete:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Seen], dict[str, dict[str, float]]]:
        """Begin episode 0 of `seed`, or the next episode; `options` has no use."""
        if seed is not None:
            if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
                raise BadInput(f"seed={seed!r}: must be a whole number, at least 0")
            self.batched.set_seed(int(seed))
        self._now = self.batched.reset()
        self.agents = list(self.possible_agents)
        nothing = dict.fromkeys((*terms_of(self.world.rules), "own_reward"), 0.0)
        self._show()
        return self._observations(), {agent: dict(nothing) for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Seen],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, float]],
    ]:
        """Step with one action of every robot; after the end, no actions return empty dicts."""
        if not self.agents and not actions:
            return {}, {}, {}, {}, {}
        self._now[keys.ACTION] = torch.tensor([self._checked(actions)], device=self.world.device)
        frame = self.batched.step(self._now)["next"]
        self._now = step_mdp(self._now)
        reward = dict(zip(self.agents, frame[keys.REWARD].flatten().tolist(), strict=True))
        terms = {name: frame[keys.AGENTS, "info", name] for name in terms_of(self.world.rules)}
        terms["own_reward"] = frame[keys.OWN_REWARD]
        listed = {name: term.flatten().tolist() for name, term in terms.items()}
        infos = {
            agent: {name: term[index] for name, term in listed.items()}
            for index, agent in enumerate(self.agents)
        }
        terminated, truncated = (
            dict.fromkeys(self.agents, bool(frame[key]))
            for key in (keys.TERMINATED, keys.TRUNCATED)
        )
        observations = self._observations()
        if frame[keys.DONE]:
            self.agents = []
        self._show()
        return observations, reward, terminated, truncated, infos

    def state(self) -> Float[np.ndarray, "row col"]:
        """Return what all robots know together: the union of their maps, each robot as 1.

        As large as the largest house; what lies outside a smaller one is unknown.
        """
        state, rules = self.world.state, self.world.rules
        rows, cols = (slice(rules.margin, rules.margin + side) for side in self.state_space.shape)
        now = (state.step + 1).to(state.record.dtype).view(-1, 1, 1)
        return map_value(union_of_maps(state.record), now, rules)[0, rows, cols].cpu().numpy()

    def render(self) -> np.ndarray | str | None:
        """Return the house beside the robots' map, as pixels or as coloured text.

        Before the first reset it shows the world as a reset without another seed will begin it.
        `human`, written to the terminal at every step, returns nothing.
        """
        if self.render_mode is None:
            raise BadInput(
                f"render_mode=None: give one to parallel_env; {choices('', RENDER_MODES)}"
            )
        if self.render_mode == "rgb_array":
            return self.world.render()
        text = draw_text(self.world.scene())
        if self.render_mode == "ansi":
            return text
        sys.stdout.write(f"{text}\n")
        return None

    def close(self) -> None:
        """Do nothing: there is no window and no process."""

    def _checked(self, actions: Mapping[str, Any]) -> list[int]:
        """Return the actions in the robots' order. Raises BadInput unless each robot has one."""
        if not self.agents:
            raise BadInput("step: no episode is under way; call reset")
        if set(actions) != set(self.agents):
            wrong = sorted(map(str, set(actions) ^ set(self.agents)))
            raise BadInput(
                f"actions: one each for {', '.join(self.agents)}; see {', '.join(wrong)}"
            )
        for agent in self.agents:
            if not self.action_spaces[agent].contains(actions[agent]):
                raise BadInput(
                    f"actions: {agent}={actions[agent]!r}: must be 0 to {len(MOVES) - 1}"
                )
        return [int(actions[agent]) for agent in self.agents]

    def _observations(self) -> dict[str, Seen]:
        shown = self._now[keys.OBSERVATION][0].cpu().numpy()
        extras = {}
        if self.shows_adjacency:
            extras["adjacency"] = self._now[keys.ADJACENCY][0].cpu().numpy().astype(np.int8)
        if self.shows_mask:
            mask = not_known_blocked(self.world.state, self.world.rules)
            extras["action_mask"] = mask[0].cpu().numpy().astype(np.int8)
        if not extras:
            return {agent: shown[index].copy() for index, agent in enumerate(self.agents)}
        seen = {"observation": shown, **extras}
        return {
            agent: {name: array[index].copy() for name, array in seen.items()}
            for index, agent in enumerate(self.agents)
        }

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()


def parallel_env(
    settings: Settings = None,
    *,
    adjacency: bool = False,
    action_masks: bool = False,
    render_mode: str | None = None,
    **keywords: Any,
) -> ParallelCleaning:
    """Return one world of a config as a PettingZoo ParallelEnv.

    Args:
        settings: a preset by its name, or overrides such as `["house=open", "env.n_agents=3"]`;
            `env.num_envs` has no effect.
        adjacency: robots see which others they are in contact with.
        action_masks: robots see which actions lead into no wall that they know of.
        render_mode: what `render` returns: human, rgb_array, ansi; None: nothing.
        keywords: settings as `marl_clean.make_env` takes them; `checkpoint=RUN` is a run's world.

    Raises:
        BadInput: a wrong setting.
    """
    return ParallelCleaning(settings, adjacency, action_masks, render_mode, **keywords)
