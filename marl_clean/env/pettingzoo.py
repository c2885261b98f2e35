"""External tasks: copies of a PettingZoo parallel env, in the keys of this package."""

import importlib
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, final

import torch
from jaxtyping import Bool, Int
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

from marl_clean import keys
from marl_clean.config.schema import mismatch
from marl_clean.env.base import BatchedEnv
from marl_clean.errors import BadInput
from marl_clean.settings import Form, Options, Task, Worlds
from marl_clean.world.random import Purpose, random_bits

# By constructors and registries of external packages, for wrong options or names.
RAISED = (AssertionError, AttributeError, KeyError, RuntimeError, TypeError, ValueError)
Among = Callable[[int], Bool[Tensor, "agent agent"]]


@final
class PettingZoo(BatchedEnv):
    """An external task, through PettingZoo: other agents than robots, the same learners.

    ## Description
    `num_envs` copies of the parallel env `task`, each through TorchRL's PettingZooWrapper with
    all agents in the group `agents`. The rooms house, observation and planner have no effect.

    ## Actions
    `("agents", "action")`, int64 `[num_envs, n_agents]`: the task's own, discrete.

    ## Observations
    `("agents", "observation")`, float32 `[num_envs, n_agents, d]`: the task's, flattened.
    `("agents", "adjacency")`, the topology's, always the same: a task has no positions.
    `("agents", "distance_rank")`: without distances, the others in the task's order.
    `("agents", "own_reward")`, float32 `[num_envs, n_agents, 1]`: what each agent earned in the
    last step; 0 after a reset.

    ## Rewards
    `("agents", "reward")`, float32 `[num_envs, n_agents, 1]`: what an agent is paid, its
    `own_reward` unless a transform of `marl_clean.reward` splits otherwise.

    ## Starting state
    Each episode is reset with a seed that is a function of (seed, env index, episode).

    ## Episode end
    As soon as it ends for one agent: `terminated` if any is, `truncated` if any is. A task whose
    agents drop out one by one thus ends with the first of them.

    ## Resuming
    An external task cannot be saved in the middle of an episode: a resumed run keeps counting its
    episodes and begins new ones.

    Args:
        task: `mpe2.NAME` or `pettingzoo.FAMILY.NAME`; nothing else is imported.
        num_envs: copies stepped together.
        options: of the task's constructor, such as N of simple_spread.
        among: who may talk to whom among n agents: a topology's `among`.
        first_env: index of the first copy: env i of 64 equals a single env with `first_env=i`.
        seed: the seed of everything drawn.
        device: where the tensors live; the task itself runs on the CPU.

    Raises:
        BadInput: a task that is not installed, fails to start, or whose agents differ in what they
            see or can do.
    """

    episode: Int[Tensor, " env"]  # the present one of each copy
    batch_locked = True
    resumes_exactly: ClassVar[bool] = False
    gives = Form.VECTOR

    def __init__(
        self,
        task: Task,
        num_envs: Worlds,
        options: Options | None = None,
        *,
        among: Among,
        first_env: int = 0,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(device=device, batch_size=[num_envs])
        self.task, self.num_envs = task, num_envs
        self.copies = [wrapped(task, options or {}) for _ in range(num_envs)]
        self.n_agents = len(self.copies[0].possible_agents)
        others = torch.arange(self.n_agents, device=self.device)
        rank = others + (others < others[:, None])
        self.graph = {
            "adjacency": self._of_all(among(self.n_agents).to(self.device)),
            "distance_rank": self._of_all(rank.fill_diagonal_(0)),
        }
        self.env_index = torch.arange(first_env, first_env + num_envs)
        self._make_specs()
        self._set_seed(seed)

    def _make_specs(self) -> None:
        first = self.copies[0]
        agents = torch.Size([self.num_envs, self.n_agents])
        pairs = torch.Size([*agents, self.n_agents])
        width = first.observation_spec[keys.OBSERVATION].shape[1:].numel()
        actions = Categorical(first.full_action_spec[keys.ACTION].n, shape=agents)
        flag = Binary(1, torch.Size([self.num_envs, 1]), dtype=torch.bool)

        def of_agents(**specs: Any) -> Composite:
            return Composite(agents=Composite(**specs, shape=agents), shape=agents[:1])

        self.action_spec = of_agents(action=actions)
        self.observation_spec = of_agents(
            observation=Unbounded(torch.Size([*agents, width])),
            adjacency=Binary(self.n_agents, pairs, dtype=torch.bool),
            distance_rank=Bounded(0, max(self.n_agents - 1, 1), pairs, dtype=torch.int64),
            own_reward=Unbounded(torch.Size([*agents, 1])),
        )
        self.reward_spec = of_agents(reward=Unbounded(torch.Size([*agents, 1])))
        self.done_spec = Composite({key: flag.clone() for key in keys.ENDINGS}, shape=agents[:1])
        self.to(self.device)

    @property
    def episode_seeds(self) -> Int[Tensor, " env"]:
        """The seeds with which the present episodes were reset."""
        return random_bits(self.seed_in_use, self.env_index, self.episode, Purpose.START)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        resets = (
            torch.ones(self.num_envs, dtype=torch.bool) if mask is None else mask.cpu().view(-1)
        )
        self.episode = self.episode + resets
        seeds = self.episode_seeds
        width = self.observation_spec[keys.OBSERVATION].shape[-1]
        # TorchRL uses only the rows that reset.
        seen = torch.zeros(self.num_envs, self.n_agents, width)
        for row in resets.nonzero()[:, 0].tolist():
            begun = self.copies[row].reset(seed=int(seeds[row]))
            seen[row] = begun[keys.OBSERVATION].flatten(1)
        no_end = torch.zeros(self.num_envs, 1, dtype=torch.bool)
        entries = {"observation": seen, "own_reward": torch.zeros_like(seen[..., :1])}
        return self._frame(entries, [no_end.clone() for _ in keys.ENDINGS])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        chosen = tensordict.select(keys.ACTION).cpu()
        action, count = chosen[keys.ACTION], self.full_action_spec[keys.ACTION].n
        if wrong := action[(action < 0) | (action >= count)].tolist():
            raise BadInput(f"action {wrong[0]}: valid: 0 to {count - 1}")
        # As TorchRL's SerialEnv does it: `step` would check each copy's every entry again.
        frames = [
            copy._step(action) for copy, action in zip(self.copies, chosen.unbind(0), strict=True)
        ]
        seen = torch.stack([frame[keys.OBSERVATION] for frame in frames]).flatten(2)
        earned = torch.stack([frame[keys.REWARD] for frame in frames])
        endings = [torch.stack([frame[key] for frame in frames]) for key in keys.ENDINGS]
        entries = {"observation": seen.float(), "own_reward": earned, "reward": earned.clone()}
        return self._frame(entries, endings)

    def _frame(self, entries: dict[str, Tensor], endings: list[Tensor]) -> TensorDict:
        shape = [self.num_envs, self.n_agents]
        agents = TensorDict({**entries, **self.graph}, shape)
        flags = dict(zip(keys.ENDINGS, endings, strict=True))
        return TensorDict({keys.AGENTS: agents, **flags}, shape[:1]).to(self.device)

    def _of_all(self, matrix: Tensor) -> Tensor:
        return matrix.expand(self.num_envs, -1, -1)

    def _set_seed(self, seed: int | None) -> None:
        """Fix everything that is drawn; the next reset starts episode 0 of this seed."""
        if seed is None:
            raise BadInput("seed=None: must be an integer")
        self.seed_in_use = seed
        self.episode = torch.full((self.num_envs,), -1)

    def state_dict(self, *args: Any, **kwargs: Any) -> OrderedDict[str, Tensor]:
        """Return the seed and each copy's episode; its state within the episode is unknown."""
        return OrderedDict(seed=torch.tensor(self.seed_in_use), episode=self.episode.clone())

    def load_state_dict(self, state_dict: Mapping[str, Tensor], *args: Any, **kwargs: Any) -> None:
        """Resume the count of episodes; the next reset begins those after the saved ones.

        Raises:
            BadInput: the state has another number of copies.
        """
        if state_dict["episode"].shape != self.episode.shape:
            raise BadInput("env state: sizes differ from this env's; same config needed")
        self.seed_in_use = int(state_dict["seed"])
        self.episode = state_dict["episode"].clone()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Close the copies, and with them their windows and files."""
        if not self.is_closed:
            for copy in self.copies:
                copy.close()
        super().close(raise_if_closed=raise_if_closed)


def wrapped(task: str, options: Mapping[str, Any]) -> PettingZooWrapper:
    """Return one copy of a task, all its agents in one group. Raises BadInput as `PettingZoo`."""
    if reason := mismatch(task, Task):
        raise BadInput(f"env.task: {reason}")
    try:
        env = make_parallel(task, options)
        reason = not_shared(env)
        if reason is None:
            with warnings.catch_warnings():
                # It warns of all versions except one of 2023; our tests cover the pinned one.
                warnings.filterwarnings("ignore", "PettingZoo in TorchRL is tested")
                return PettingZooWrapper(env, group_map={keys.AGENTS: list(env.possible_agents)})
    except ModuleNotFoundError as error:
        package = task.partition(".")[0]
        known = (error.name or "").startswith(f"{package}.")
        missing = f"needs {error.name}, which is not installed; pip install {error.name}"
        reason = f"{package} has no such task" if known else missing
    except RAISED as error:
        reason = f"{type(error).__name__}: {(str(error) or 'it fails to start').splitlines()[0]}"
    raise BadInput(f"env.task={task}: {reason}")


def make_parallel(task: str, options: Mapping[str, Any]) -> Any:
    """Return the bare parallel env, from PettingZoo's registry or one of mpe2's modules."""
    package, *family, name = task.split(".")
    if package == "pettingzoo":
        name, _, version = name.rpartition("_v")
        make = importlib.import_module(package).make
        unknown = importlib.import_module("pettingzoo.env_registry.exceptions")
        try:
            return make("parallel", f"{family[0]}/{name}-v{version}", **options)
        except unknown.PettingZooRegistryError as error:
            raise ValueError(str(error)) from None
    return importlib.import_module(task).parallel_env(**options)


def not_shared(env: Any) -> str | None:
    """Return why one network cannot act for all agents of a task; None where it can."""
    agents = env.possible_agents
    env.reset(seed=0)
    if list(env.agents) != list(agents):
        return "its agents come and go; a task whose agents all begin together is valid"
    for what, spaces, kind in (
        ("sees", [env.observation_space(agent) for agent in agents], "Box"),
        ("does", [env.action_space(agent) for agent in agents], "Discrete"),
    ):
        if wrong := [space for space in spaces if type(space).__name__ != kind]:
            text = " ".join(str(wrong[0]).split())[:80]
            return f"what an agent {what} must be a {kind}, not {text}"
        shapes = {
            (space.shape, getattr(space, "n", 0), getattr(space, "start", 0)) for space in spaces
        }
        if len(shapes) > 1 or (kind == "Discrete" and spaces[0].start):
            return f"what an agent {what} must have the same size for all, as in simple_spread"
    return None
