"""What a user may write; checked by mypy, never run."""

from pathlib import Path
from typing import Any, assert_type

from matplotlib.figure import Figure
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

import marl_clean
from marl_clean import BadInput, CleaningEnv, Run, Table, compare, evaluate, load_policy, make_env

run = marl_clean.train("quick", comm="tarmac", n_agents=3, seed=0)
assert_type(run, Run)
assert_type(run.folder, Path)
assert_type(run.config, DictConfig)
assert_type(run.policy, TensorDictModuleBase)
assert_type(run.env(num_envs=8), TransformedEnv)
assert_type(run.evaluate(house="apartment", intervention="zero"), Table)
assert_type(run.curve(), Figure)
assert_type(run.replay(), Path)
assert_type(run.table, Table)
assert_type(run.table[0], dict[str, Any])
assert_type(run.table[:2], list[dict[str, Any]])
assert_type(Run("runs/NAME").table.rows, list[dict[str, Any]])
assert_type(evaluate(run, houses=5), Table)
assert_type(compare("runs/a", Path("runs/b"), run, against="none"), Table)
assert_type(make_env(["house=open"], n_agents=3), TransformedEnv)
assert_type(load_policy(run), TensorDictModuleBase)
assert_type(marl_clean.__version__, str)
worlds: type[CleaningEnv] = CleaningEnv
error: type[ValueError] = BadInput
marl_clean.trian("quick")  # type: ignore[attr-defined]
Run(3)  # type: ignore[arg-type]
compare("runs/a", agianst="none")  # type: ignore[call-arg]
