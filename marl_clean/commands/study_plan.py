"""What a preset's section `study` says: read and checked without composing a config.

The same reader takes the section that is frozen in a study's folder.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

from marl_clean.config.schema import Problem, choices, problems_of_mapping
from marl_clean.config.sections import Study, StudyRule
from marl_clean.errors import BadInput
from marl_clean.evaluation.paired import FINISHED
from marl_clean.evaluation.records import MEASURES
from marl_clean.evaluation.rules import CLAIMS, Claim, Form

PLANNERS = ("random", "nearest_unknown", "nearest_unknown+greedy")
"""Measured beside every run, on the same houses: an arm may be compared with one of them."""
VALID = (*MEASURES, FINISHED)
CONFIDENCE = 0.95
NAME = re.compile(r"\w[\w.-]{0,59}")  # of an arm: part of a folder's name
WORDS = {Form.MEAN: "{arm}", Form.DIFFERENCE: "{arm} - {than}", Form.RATIO: "{arm} / {than}"}


@dataclass(frozen=True)
class Rule:
    """An acceptance rule: a claim about a measure of an arm, and what the arm is compared with."""

    name: str
    arm: str
    than: str | None
    measure: str
    claim: Claim

    @property
    def arms(self) -> list[str]:
        """The arms whose runs the rule needs."""
        return [arm for arm in (self.arm, self.than) if arm is not None and arm not in PLANNERS]

    @property
    def says(self) -> str:
        """The rule in a line, as `T_90: plan / silent < 0.95`."""
        sides = WORDS[self.claim.form].format(arm=self.arm, than=self.than)
        return f"{self.measure}: {sides} {'<' if self.claim.below else '>'} {self.claim.bound:g}"


def read_study(section: Mapping[str, Any]) -> tuple[dict[str, Any], list[Rule]]:
    """The section with its defaults filled in, and its rules.

    Raises BadInput for a key, an arm, a measure or a rule that is not valid.
    """
    types = get_type_hints(Study, include_extras=True)
    _refuse(problems_of_mapping(section, types, "study.", Study.__required_keys__))
    for key in ("arms", "rules"):
        if not section[key]:
            raise BadInput(f"study.{key}: is empty; give at least one")
    arms, seeds = section["arms"], section["seeds"]
    for arm in arms:
        if not isinstance(arm, str) or not NAME.fullmatch(arm):
            raise BadInput(f"study.arms.{arm}: must be named by letters, digits and _ . - alone")
        if arm in PLANNERS:
            raise BadInput(f"study.arms.{arm}: is the name of a planner; choose another")
    if twice := [seed for seed in seeds if seeds.count(seed) > 1]:
        raise BadInput(f"study.seeds: {twice[0]} stands there twice; once is valid")
    filled = {
        "question": None,
        "budget": None,
        "houses": None,
        "baseline": next(iter(arms)),
        "oracle": None,
        "confidence": CONFIDENCE,
        **section,
    }
    _check_name("study.baseline", filled["baseline"], arms)
    if filled["oracle"] is not None:
        _check_name("study.oracle", filled["oracle"], arms)
        if filled["oracle"] == filled["baseline"]:
            raise BadInput(f"study.oracle: {filled['oracle']} is the baseline; name another arm")
    _check_name("study.measure", filled["measure"], VALID)
    return filled, [_rule(str(name), rule, filled) for name, rule in section["rules"].items()]


def _rule(name: str, given: Mapping[str, Any], study: Mapping[str, Any]) -> Rule:
    """One rule of a study whose other keys are checked. Raises BadInput where it is not valid."""
    key = f"study.rules.{name}"
    _refuse(
        problems_of_mapping(
            given, get_type_hints(StudyRule, include_extras=True), f"{key}.", ["arm"]
        )
    )
    bounds = [bound for bound in CLAIMS if bound in given]
    if len(bounds) != 1:
        held = " and ".join(bounds) or "no bound"
        raise BadInput(f"{key}: has {held}; give one of {', '.join(CLAIMS)}")
    form, below = CLAIMS[bounds[0]]
    arm, measure = given["arm"], given.get("measure", study["measure"])
    _check_name(f"{key}.arm", arm, study["arms"])
    _check_name(f"{key}.measure", measure, VALID)
    claim = Claim(form, float(given[bounds[0]]), below)
    if form is Form.MEAN:
        if "than" in given:
            raise BadInput(
                f"{key}.than: {bounds[0]} is a bound on the arm alone; leave `than` out, or give "
                f"difference_{bounds[0]} or ratio_{bounds[0]}"
            )
        return Rule(name, arm, None, measure, claim)
    than = given.get("than", study["baseline"])
    _check_name(f"{key}.than", than, (*study["arms"], *PLANNERS))
    if than == arm:
        raise BadInput(f"{key}.than: {than} is the arm itself; name another one or a planner")
    if form is Form.RATIO and measure == "return":
        raise BadInput(f"{key}.{bounds[0]}: a return may be negative; give a difference instead")
    return Rule(name, arm, than, measure, claim)


def _check_name(key: str, name: str, valid: Any) -> None:
    if name not in valid:
        raise BadInput(f"{key}: {name}: no such one; {choices(name, valid)}")


def _refuse(problems: Any) -> None:
    first: Problem | None = next(iter(problems), None)
    if first is not None:
        raise BadInput(f"{first.key}: {first.reason}")
