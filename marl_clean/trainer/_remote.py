"""TorchRL's collectors in processes of their own: on this machine, or on a Ray cluster.

Each process has a share of the worlds and a learner that acts in them. Before every block it gets
the trainer's weights and how far the training is; while the trainer learns it waits, so what is
collected depends on nothing but the config and its seed.
"""

import logging
import os
import signal
import sys
import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.collectors import BaseCollector, MultiSyncCollector
from torchrl.envs import EnvBase

from marl_clean.errors import BadInput
from marl_clean.learning.agent import Agent
from marl_clean.settings import Collectors, StatesOf
from marl_clean.trainer._annealing import Annealing
from marl_clean.trainer._collecting import CarriedCollector, collector_settings
from marl_clean.trainer._collectors import Collecting, InTheTrainer, Moment, restore_into, state_of
from marl_clean.trainer._random import random_state, restore_random
from marl_clean.trainer._share import MakeShare, Share
from marl_clean.trainer._warm_start import WarmStart

Weights = Mapping[str, Tensor]
Imitate = tuple[str | None, float, StatesOf]
"""The planner, until which frame it demonstrates, and whose states they are: see `WarmStart`."""
Make = Callable[[], tuple[Share, WarmStart]]
CPU = torch.device("cpu")
ENDING_SECONDS = 20.0  # for processes to end; those that do not are killed


class ShareCollector(CarriedCollector):
    """The collector of one process. TorchRL makes it there, and calls its methods by their names.

    `create_env_fn` makes the share and its `WarmStart`: env and policy belong together.
    """

    def __init__(self, create_env_fn: Make, **settings: Any) -> None:
        self.share, self.warm_start = create_env_fn()
        for name in ("create_env_kwargs", "policy", "policy_factory"):
            settings.pop(name, None)
        super().__init__(self.share.env, self.warm_start.policy, **settings)

    def prepare(self, weights: Weights, moment: Moment) -> None:
        """Set everything that a block depends on, as the trainer has it at this moment."""
        env, agent = self.share.env, self.share.agent
        agent.network.load_state_dict(weights)
        annealing = Annealing()
        annealing.share = moment.finished
        annealing.set(agent, env, moment.frames / moment.total_frames)
        self.warm_start.at(moment.frames)
        if moment.num_open is not None:
            env.base_env.open_houses(moment.num_open)

    def progress(self) -> dict[str, float]:
        return self.share.env.base_env.progress()

    def whole_state(self) -> dict[str, Any]:
        state = state_of(self.share.env, self, self.warm_start)
        return {**state, "random": random_state(CPU)}

    def restore_whole(self, state: Mapping[str, Any]) -> None:
        restore_into(self.share.env, self, self.warm_start, state)
        restore_random(state["random"], CPU)


def _make(
    make_share: MakeShare,
    imitate: Imitate,
    num_open: int | None,
    index: int,
    num: int,
) -> tuple[Share, WarmStart]:
    share = make_share(index, num)
    if num_open is not None:  # a collector begins its first episodes when it is made
        share.env.base_env.open_houses(num_open)
    return share, WarmStart(share.agent, share.env, *imitate)


class Remote(Collecting):
    """The worlds' blocks, collected by `num` processes at once and put together in their order."""

    def __init__(
        self,
        env: EnvBase,
        agent: Agent,
        make_share: MakeShare,
        imitate: Imitate,
        num_open: int | None,
        num: int,
        frames_per_batch: int,
    ) -> None:
        self.env, self.agent, self.num = env, agent, num
        self.weights = {name: w.cpu().clone() for name, w in agent.network.state_dict().items()}
        make = [partial(_make, make_share, imitate, num_open, index, num) for index in range(num)]
        with self.in_one_line():
            self.collector = self.start(make, frames_per_batch)
        self.blocks = iter(self.collector)

    @abstractmethod
    def start(self, make: Sequence[Make], frames_per_batch: int) -> BaseCollector:
        """Return TorchRL's collector over processes that begin with these."""

    @abstractmethod
    def next_block(self) -> TensorDictBase:
        """Return the next block `[env, time]`, in memory that is not written again."""

    def block(self, moment: Moment) -> TensorDictBase:
        for name, weight in self.agent.network.state_dict().items():
            self.weights[name].copy_(weight)
        self.call("prepare", *([(self.weights, moment)] * self.num))
        with self.in_one_line():
            return self.next_block().exclude("collector").to(self.env.device)

    def progress(self) -> dict[str, float]:
        shares = self.call("progress")
        return {name: sum(share[name] for share in shares) / self.num for name in shares[0]}

    def state(self) -> dict[str, Any]:
        return {"shares": self.call("whole_state")}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.call("restore_whole", *((share,) for share in state["shares"]))

    def call(self, name: str, *arguments: tuple[Any, ...]) -> list[Any]:
        """Call a method of every process's collector, each with its arguments."""
        with self.in_one_line():
            return self.collector.map_fn(name, list(arguments) or None)

    @contextmanager
    def in_one_line(self) -> Iterator[None]:
        """Raise BadInput for whatever a collector's process, or what it runs on, fails with."""
        try:
            yield
        except BadInput:
            raise
        except Exception as error:  # of TorchRL, Ray and the process alike
            [line, *_] = str(error).splitlines() or [type(error).__name__]
            raise BadInput(
                f"trainer.collectors: a process that collects has ended ({line[:200]}); the same"
                " command resumes the run from its last saved state"
            ) from error


class Processes(Remote):
    """Processes on this machine, of one thread each."""

    def start(self, make: Sequence[Make], frames_per_batch: int) -> BaseCollector:
        self.threads = torch.get_num_threads()  # the trainer's, which learns while they wait
        return MultiSyncCollector(
            list(make),
            collector_class=ShareCollector,
            num_threads=self.threads,
            cat_results=0,
            use_buffers=True,
            init_fn=leave_signals_to_trainer,
            **collector_settings(frames_per_batch),
        )

    def next_block(self) -> TensorDictBase:
        return next(self.blocks)  # put together anew from the buffers of the processes

    def shutdown(self) -> None:
        self.collector.shutdown(timeout=ENDING_SECONDS)
        torch.set_num_threads(self.threads)


class RayActors(Remote):
    """Actors of a Ray cluster: the one that RAY_ADDRESS names, else one begun on this machine."""

    def start(self, make: Sequence[Make], frames_per_batch: int) -> BaseCollector:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no request leaves
        from torchrl.collectors.distributed import RayCollector

        begun: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if not os.environ.get("RAY_ADDRESS"):
            # As many as asked for, or actors would wait for CPUs for ever.
            begun |= {"include_dashboard": False, "num_cpus": max(self.num, os.cpu_count() or 1)}
        for of_weights in ("RayCollector iteration started before", "The policy is not an nn.Mod"):
            warnings.filterwarnings("ignore", of_weights)  # they come with `prepare`
        settings = {**collector_settings(frames_per_batch), "total_frames": sys.maxsize}
        registers = settings.pop("auto_register_policy_transforms")
        return RayCollector(
            list(make),
            collector_class=ShareCollector,
            collector_kwargs=[
                {"auto_register_policy_transforms": registers} for _ in range(self.num)
            ],
            num_collectors=self.num,
            remote_configs={"num_cpus": 1},
            ray_init_config=begun,
            weight_sync_schemes={},
            sync=True,
            **settings,
        )

    def next_block(self) -> TensorDictBase:
        return next(self.blocks).flatten(0, 1)

    def shutdown(self) -> None:
        self.collector.shutdown()


BACKENDS: dict[str, type[Remote]] = {"process": Processes, "ray": RayActors}


def make_collecting(
    env: EnvBase,
    agent: Agent,
    make_share: MakeShare | None,
    imitate: Imitate,
    num_open: int | None,
    collectors: Collectors,
    frames_per_batch: int,
) -> Collecting:
    """Return what collects: the env itself, or processes of `trainer.collectors`, started here.

    The agent learns from demonstrations where there are any. Raises BadInput where processes
    cannot be started.
    """
    if collectors.backend == "none":
        return InTheTrainer(env, WarmStart(agent, env, *imitate), frames_per_batch)
    if make_share is None:
        raise BadInput("trainer.collectors: needs an env that other processes can make; use train")
    kind = BACKENDS[collectors.backend]
    return kind(env, agent, make_share, imitate, num_open, collectors.num, frames_per_batch)


def leave_signals_to_trainer() -> None:
    """Ignore in this process what ends a training: the trainer saves first, then ends this."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
