"""The weights that come with the repository still load, and still clean houses."""

from pathlib import Path

from marl_clean import load_policy
from marl_clean.config.compose import checked
from marl_clean.config.stored import load_config
from marl_clean.evaluation.evaluator import evaluate
from marl_clean.evaluation.records import means

SHIPPED = Path(__file__).parent.parent / "weights" / "approach_2_frontier"


def test_the_shipped_policy_cleans_validation_houses() -> None:
    """A silent change of dynamics, observation or network would show here.

    On 200 validation houses it finished all; of 20 one may be lost to another torch's rounding.
    """
    cfg = checked(load_config(SHIPPED))
    policy = load_policy(SHIPPED)
    records = evaluate(cfg, lambda env: policy, house_set="validation", count=20, epsilon=0.02)
    measured = means(records)
    assert measured["finished"] >= 0.95
    assert measured["T_90"] < 50  # nearest_unknown needs 47, this policy 40
