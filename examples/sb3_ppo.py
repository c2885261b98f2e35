"""PPO of Stable-Baselines3 on the cleaning world, its robots side by side through SuperSuit.

    pip install 'marl-clean[pettingzoo]' stable-baselines3 supersuit
    python examples/sb3_ppo.py [steps of all robots, 20,000]

One policy for all robots, which do not talk: each is one env of a vector env to PPO. Tried with
stable-baselines3 2.9.2, supersuit 3.11.0, pettingzoo 1.27.0.
"""

import sys

import numpy as np
import supersuit
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from marl_clean import pettingzoo

HOUSES = {"rows": [6, 8], "cols": [6, 8], "train_houses": 64, "view_size": 7, "max_steps": 200}


def main(steps: int) -> None:
    """Train, then play one episode and say how much of the house is clean."""
    set_random_seed(0)  # SuperSuit's vector env takes no seed of PPO's
    world = pettingzoo.parallel_env(n_agents=2, reward="individual", **HOUSES)
    robots = supersuit.pettingzoo_env_to_vec_env_v1(world)
    envs = supersuit.concat_vec_envs_v1(robots, 4, num_cpus=1, base_class="stable_baselines3")
    learner = PPO("MlpPolicy", envs, n_steps=128, batch_size=256)
    learner.learn(steps)
    seen, _ = world.reset(seed=1)
    while world.agents:
        actions, _ = learner.predict(np.stack([seen[agent] for agent in world.agents]))
        seen, *_ = world.step(dict(zip(world.agents, actions.tolist(), strict=True)))
    print(f"{100 * world.world.progress()['coverage']:.0f} % clean at the end of an episode")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20_000)
