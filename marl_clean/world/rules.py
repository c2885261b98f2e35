"""The readings of the paper that are fixed for one environment."""

import math
import typing
from dataclasses import dataclass, field, fields
from fractions import Fraction

from marl_clean.config.schema import problems_of_mapping
from marl_clean.errors import BadInput
from marl_clean.settings import (
    Cases,
    Decay,
    Knowledge,
    KnowledgeOfTeam,
    Memory,
    NonNegativeFloat,
    NonPositiveFloat,
    ObstaclePay,
    PaidBy,
    PositiveInt,
    Probability,
    Sensor,
    Spills,
    Starts,
    UncleanedAtMost,
    UnknownPaysAs,
    WallPays,
)

UNKNOWN_VALUE = -0.2
BLOCKED_VALUE = -1.0
ROBOT_VALUE = 1.0
CLEANED_VALUE = 0.5
DIRTY_VALUE = 0.0
DISCOVERY_PAYS = 2.0

NEVER = 1 << 30  # above every age: records hold up to 2^22 steps

Margin = PositiveInt  # a name of its own, no setting's: who builds the env hands it over


@dataclass(frozen=True)
class Rules:
    """Every open point of the paper with the reading taken (paper §3.2 and §3.3).

    A config gives them in its section `env`, one key each, `margin` apart.

    Attributes:
        memory: whose map a robot reads and writes: shared, private or merged.
        knowledge: what the map holds at step 0: unknown, memorised or stale; or a list of these,
            one a robot, see `knowledge_of_each`.
        starts: where robots start that the house gives no place: on drawn cells anywhere, or
            together, one on a drawn cell and the others on the cells nearest to it on foot.
        sensor: how walls become known: bump, or touch4 (the four neighbours of every robot are
            known).
        decay_steps: C, the steps after which a cell counts as dirty again; None: what is clean
            stays clean, and is shown as 0.5.
        decay: whether a cleaned cell falls by 1/C or by 0.5/C a step.
        uncleaned_at_most: cells with a value up to this count as uncleaned, in [0, 0.5).
        unknown_pays_as: v of an unknown (or wrongly blocked) cell in 2 - 2 v, -0.2 or 0.
        cases: whether the terms add up or only the last that applies counts.
        obstacles: whether a bump pays the first time or every time.
        stuck_after: steps without a newly cleaned cell that end an episode; None: never.
        wall_pays: what discovering a wall pays, from 0 to DISCOVERY_PAYS, which is what entering an
            unknown cell pays.
        paid_by: whether cleaning and discovery are valued against a robot's own map or the union of
            all robots' maps; the same under shared maps, which are one.
        collision_pays: what each collision adds to a robot's own reward, a term of its own, at most
            0; beside the three of the paper under both readings of `cases`.
        robots_shown: whether other robots show in what a robot sees; its own place always does.
        robots_noted: whether private maps note of a robot in contact that the cell it stands on is
            available and has just been cleaned; for maps that are not private False.
        shaping: w, the weight of the shaping term, which a transform adds to what robots earn where
            it is above 0; nothing in the worlds themselves depends on it.
        bump_noise: probability that a bump goes unnoticed: nothing is written, nothing paid.
        spills: patches of clean cells that become dirty again, see `Spills`.
        margin: cells around the house in every stored matrix: the ring's 1 and half the view.
        decay_a_step: how much the shown value of a cleaned cell falls a step.
        dirty_after: the age in steps from which a cell is dirty, ceil(0.5 / decay); NEVER
            without decay.
        uncleaned_after: the age from which entering a cell pays as cleaning: the smallest whose
            value is at most `uncleaned_at_most`.

    Raises:
        BadInput: a value outside its range, or robots noted that none sees or has a map of.
    """

    memory: Memory = Memory.SHARED
    knowledge: KnowledgeOfTeam = Knowledge.UNKNOWN
    starts: Starts = Starts.ANYWHERE
    sensor: Sensor = Sensor.BUMP
    decay_steps: PositiveInt | None = 200
    decay: Decay = Decay.FORMULA
    uncleaned_at_most: UncleanedAtMost = 0.0
    unknown_pays_as: UnknownPaysAs = UNKNOWN_VALUE
    cases: Cases = Cases.ADD
    obstacles: ObstaclePay = ObstaclePay.FIRST
    stuck_after: PositiveInt | None = 100
    wall_pays: WallPays = DISCOVERY_PAYS
    paid_by: PaidBy = PaidBy.OWN_MAP
    collision_pays: NonPositiveFloat = 0.0
    robots_shown: bool = True
    robots_noted: bool = False
    shaping: NonNegativeFloat = 0.0
    bump_noise: Probability = 0.0
    spills: Spills = Spills()
    margin: Margin = 7
    decay_a_step: float = field(init=False)
    dirty_after: int = field(init=False)
    uncleaned_after: int = field(init=False)

    def __post_init__(self) -> None:
        types = typing.get_type_hints(Rules, include_extras=True)
        values = {rule.name: getattr(self, rule.name) for rule in fields(self) if rule.init}
        values["spills"] = vars(self.spills)
        for problem in problems_of_mapping(values, types, "env.", ()):
            raise BadInput(f"{problem.key}: {problem.reason}")
        check_noted(self.robots_noted, self.robots_shown, self.memory)

        # Ages are decided on fractions, once: floats would round at the thresholds.
        half = Fraction(1, 2)
        threshold = Fraction(str(self.uncleaned_at_most))
        decay, dirty_after, uncleaned_after = Fraction(0), NEVER, NEVER
        if self.decay_steps is not None:
            decay = (1 if self.decay is Decay.FORMULA else half) / Fraction(self.decay_steps)
            dirty_after = math.ceil(half / decay)
            uncleaned_after = math.ceil((half - threshold) / decay)
        object.__setattr__(self, "decay_a_step", float(decay))
        object.__setattr__(self, "dirty_after", dirty_after)
        object.__setattr__(self, "uncleaned_after", uncleaned_after)

    @property
    def kinds_of_knowledge(self) -> list[Knowledge]:
        """What is known by any robot at step 0; repeated where a list gives it to several."""
        return [self.knowledge] if isinstance(self.knowledge, str) else self.knowledge


def check_noted(robots_noted: bool, robots_shown: bool, memory: Memory) -> None:
    """Raises BadInput where robots are to be noted that nobody sees, or all maps hold anyway."""
    if robots_noted and not robots_shown:
        raise BadInput("env.robots_noted=true: nobody is seen; valid with env.robots_shown=true")
    if robots_noted and memory != Memory.PRIVATE:
        raise BadInput(f"env.robots_noted=true: maps are {memory}; valid with env.memory=private")


def knowledge_of_each(knowledge: KnowledgeOfTeam, memory: Memory, n_agents: int) -> list[Knowledge]:
    """Return what each of `n_agents` robots knows at step 0: the entries of a list, or one for all.

    Raises:
        BadInput: a list of another length, or of several kinds for one shared map.
    """
    if isinstance(knowledge, str):
        return [knowledge] * n_agents
    each = list(knowledge)
    wrong = f"env.knowledge=[{', '.join(each)}]"
    valid = f"valid: {', '.join(Knowledge)}"
    if len(each) != n_agents:
        raise BadInput(
            f"{wrong}: has {len(each)} entries for env.n_agents={n_agents}; give one for each"
            f" robot, or one value for all; {valid}"
        )
    if memory == Memory.SHARED and len(set(each)) > 1:
        raise BadInput(
            f"{wrong}: one map for all cannot be known by some robots only; set env.memory=private"
            f" or merged, or give one value for all; {valid}"
        )
    return each
