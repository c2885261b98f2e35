"""The weights that come with the repository still load, and still clean houses."""

import pytest

from marl_clean import load_policy
from marl_clean.config.compose import checked
from marl_clean.config.stored import find_run, load_config
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.evaluation.records import means


@pytest.mark.long
@pytest.mark.parametrize(
    ("run", "most_steps"),
    [("approach_2_frontier", 50), ("any_house", 110)],  # nearest_unknown needs 47 and 104
)
def test_a_shipped_policy_cleans_validation_houses(run: str, most_steps: int) -> None:
    """A silent change of dynamics, observation or network would show here.

    On 200 validation houses they finished all; of 20 one may be lost to another torch's rounding.
    """
    folder = find_run(run)
    cfg, policy = checked(load_config(folder)), load_policy(folder)
    epsilon = cfg.evaluation.epsilon
    records = evaluate(cfg, lambda env: policy, house_set="validation", count=20, epsilon=epsilon)
    measured = means(records)
    assert measured["finished"] >= 0.95
    assert measured["T_90"] < most_steps
