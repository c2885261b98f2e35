"""Whether an acceptance rule is met: a mean, a difference or a ratio of means against a bound.

Every form is a mean that is 0 where the bound holds exactly, over runs r and houses h:

    mean of d_rh(b) = u_rh - b w_rh
    mean: u = x, w = 1;    difference: u = x - y, w = 1;    ratio: u = x, w = y

x are an arm's values, y those that it is compared with, seed by seed in the same houses. The test
of mean d(b) = 0 is `statistics.paired_p`, as in every comparison. The interval holds the bounds b
that this test does not refuse (of a ratio: E. Fieller, 1954), so that the two never disagree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from marl_clean.evaluation.statistics import holm, paired_p, sampled_means


class Form(StrEnum):
    """What a bound is on."""

    MEAN = ""
    DIFFERENCE = "difference_"
    RATIO = "ratio_"


class Outcome(StrEnum):
    """What a study says of a rule."""

    MET = "met"
    NOT_MET = "not met"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class Claim:
    """A form's value lies below its bound, or above it."""

    form: Form
    bound: float
    below: bool


CLAIMS = {f"{form}{side}": (form, side == "below") for form in Form for side in ("below", "above")}
"""The keys of a rule that hold a bound, each with its form and whether it is an upper one."""


@dataclass(frozen=True)
class Effect:
    """What was measured of a claim.

    Attributes:
        value: the mean, difference or ratio of means; None without values, or over a mean of 0.
        interval: of the value; None where the data bound it on no side, or on one alone.
        p: two-sided, of the value being the bound.
        right_side: whether the value lies where the claim has it.
    """

    value: float | None
    interval: tuple[float, float] | None
    p: float
    right_side: bool


def effect(
    claim: Claim,
    values: Float[np.ndarray, "run house"],
    baseline: Float[np.ndarray, "other_run other_house"] | None,
    confidence: float,
) -> Effect:
    """The effect that a claim is about; `baseline` has as many runs as `values`, or one.

    A house without a value on either side is left out. Raises BadInput where runs or houses differ
    in number.
    """
    first, second = values, np.ones_like(values)
    if baseline is not None and claim.form is Form.DIFFERENCE:
        first = values - baseline
    elif baseline is not None and claim.form is Form.RATIO:
        second = np.broadcast_to(baseline, values.shape)
    known = np.isfinite(first) & np.isfinite(second)
    first, second = (np.where(known, side, np.nan) for side in (first, second))
    p = paired_p(first, claim.bound * second)
    if not known.any():
        return Effect(None, None, p, False)
    over, under = (float(_mean_of_means(side)) for side in (first, second))
    apart = over - claim.bound * under
    right_side = apart < 0 if claim.below else apart > 0
    if under == 0:
        return Effect(None, None, p, right_side)
    return Effect(over / under, _interval(first, second, over, under, confidence), p, right_side)


def decide(effects: Sequence[Effect | None], confidence: float) -> list[tuple[float, Outcome]]:
    """Each rule's p after Holm's correction over all rules of a study, and its outcome.

    None stands for a rule of which runs are missing: it is undecided, and counts in the correction.
    """
    corrected = holm([1.0 if item is None else item.p for item in effects])
    results = []
    for item, p in zip(effects, corrected, strict=True):
        if item is None or p >= 1 - confidence:
            results.append((p, Outcome.UNDECIDED))
        else:
            results.append((p, Outcome.MET if item.right_side else Outcome.NOT_MET))
    return results


def _mean_of_means(values: Float[np.ndarray, "run house"]) -> np.float64:
    """The mean over runs of the mean over houses, as in `statistics`; NaN is left out."""
    known = np.isfinite(values)
    count = known.sum(axis=1)
    sums = np.where(known, values, 0.0).sum(axis=1)
    return np.mean(sums[count > 0] / count[count > 0])


def _interval(
    first: Float[np.ndarray, "run house"],
    second: Float[np.ndarray, "run house"],
    over: float,
    under: float,
    confidence: float,
) -> tuple[float, float] | None:
    """The bounds b that the test of `over` - b `under` = 0 does not refuse.

        (over - b under)^2 <= t^2 (A - 2 b B + b^2 C)

    A, B, C: the squared errors of both means and their covariance, over runs plus over houses.
    """
    covariance, degrees = np.zeros((2, 2)), []
    for pair in zip(sampled_means(first), sampled_means(second), strict=True):
        covariance += np.cov(np.stack(pair)) / len(pair[0])
        degrees.append(len(pair[0]) - 1)
    if not degrees:
        return None
    scale = student.ppf((1 + confidence) / 2, min(degrees)) ** 2
    a, b, c = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    square = under**2 - scale * c
    if square <= 0:  # the mean of `second` may be 0 for all that the data say
        return None
    half = over * under - scale * b
    root = max(0.0, half**2 - square * (over**2 - scale * a)) ** 0.5
    return float((half - root) / square), float((half + root) / square)
