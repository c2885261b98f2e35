"""The cleaning world as a task of BenchMARL: its learners, its models, its stock transforms.

    pip install --no-deps benchmarl
    python examples/benchmarl_task.py [iterations, 2]

BenchMARL 1.5.2 asks for torchrl below 0.12. Installed with --no-deps it runs on 0.14.1 once it is
handed the collector by its older name and its value modules do without a newer check of shapes;
that is done here. Tried so, with IPPO, IQL and QMIX.
"""

import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import torchrl.collectors

# What BenchMARL 1.5.2 asks for by the name it had before torchrl 0.12.
torchrl.collectors.SyncDataCollector = torchrl.collectors.Collector

from benchmarl.algorithms import IppoConfig, IqlConfig, QmixConfig, iql, qmix
from benchmarl.environments import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl.envs import EnvBase

from marl_clean import keys, make_env

for module in (iql, qmix):
    module.QValueModule = partial(module.QValueModule, strict_shape=False)

SETTINGS = {"observation": "distances", "house": "open", "rows": [5, 6], "cols": [5, 6]}


class Cleaning(TaskClass):
    """Robots that see eight distances in small houses; `config` holds more settings."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return what makes the env; `make_env` has the batch of worlds in it."""
        where = {"num_envs": num_envs, "seed": seed or 0, "device": str(device)}
        return lambda: make_env(**{**SETTINGS, **self.config, **where})

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def has_render(self, env: EnvBase) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        return self.config["max_steps"]

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return {keys.AGENTS: [f"robot_{index}" for index in range(env.base_env.n_agents)]}

    def observation_spec(self, env: EnvBase) -> Composite:
        seen = env.full_observation_spec_unbatched[keys.OBSERVATION]
        return Composite(agents=Composite(observation=seen, shape=seen.shape[:1]))

    def info_spec(self, env: EnvBase) -> Composite | None:
        return None

    def state_spec(self, env: EnvBase) -> Composite | None:
        return None

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        return None

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name() -> str:
        return "marl_clean"


def small_experiment(iterations: int) -> ExperimentConfig:
    """BenchMARL's defaults, but small enough for a minute on a CPU and without files."""
    config = ExperimentConfig.get_from_yaml()
    config.sampling_device = config.train_device = config.buffer_device = "cpu"
    config.max_n_iters = iterations
    config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = 320
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = 8
    config.on_policy_n_minibatch_iters = config.off_policy_n_optimizer_steps = 2
    config.on_policy_minibatch_size = config.off_policy_train_batch_size = 64
    config.off_policy_memory_size = 1_000
    config.evaluation_interval, config.evaluation_episodes = 320, 4
    config.loggers, config.create_json, config.render = [], False, False
    return config


def train(algorithm: Any, iterations: int) -> Experiment:
    """Train one algorithm and return the finished experiment."""
    experiment = Experiment(
        task=Cleaning("cleaning", {"n_agents": 3, "max_steps": 40, "train_houses": 8}),
        algorithm_config=algorithm.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=small_experiment(iterations),
    )
    experiment.run()
    return experiment


if __name__ == "__main__":
    for algorithm in (IppoConfig, IqlConfig, QmixConfig):
        experiment = train(algorithm, int(sys.argv[1]) if len(sys.argv) > 1 else 2)
        print(f"{algorithm.__name__}: {experiment.total_frames} frames")
