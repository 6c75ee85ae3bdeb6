"""Drawing cases: which arm has which faults, from a seed and the case's number alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from sim2real.excitation.suite import READY

from np_blind.arm.plant.physics import Physics, nominal_physics
from np_blind.arm.sampling import six_hinges
from np_blind.arm.sampling.background import apply_background, apply_session_changes
from np_blind.arm.sampling.changes import FIRST_DAY, SECOND_DAY, change_between_sessions, read_levels
from np_blind.arm.sampling.faults import EFFECTS, Fault, Parameters, apply, largest, limit_of, visible, widen
from np_blind.arm.sampling.measured_friction import apply_measured_friction
from np_blind.arm.sampling.unknown_faults import UNKNOWN_FAULTS, apply_unknown_fault, draw_unknown_faults

UNKNOWN_FAULT_KIND = "stranger"  # as in sealed keys and published results
KINDS = {"null": 0.15, "single": 0.5, "pair": 0.175, UNKNOWN_FAULT_KIND: 0.175}
NEAREST = 0.8  # size from which on faults are drawn
SETS = {
    "development": 1,
    "locked": 2,
    "development_changes": 3,
    "locked_changes": 4,
    "development_six": 61,
    "locked_six": 62,
    "development_friction": 71,
    "locked_friction": 72,
}
"""The seeds of development and of the locked test lie apart. Sets of changes have two recordings of each arm.
In sets of friction every arm has measured friction (`measured_friction`), and most have one effect of the catalogue besides."""
CHANGES = ("development_changes", "locked_changes", "development_six", "locked_six")
FRICTION = (SETS["development_friction"], SETS["locked_friction"])
FRICTION_ALONE = 0.25  # of the cases of a set of friction
SIX_HINGES = (SETS["development_six"], SETS["locked_six"])
UNCHANGED = 1 / 3  # of the cases of a set of changes
MOST_ALWAYS, LARGEST_ALWAYS = 3, 5.0  # faults that an arm had before any change, and times their limit, at most

# On one joint these look alike in any data of its motion: a pair of them would be one effect.
_ALIKE = (
    {
        "coulomb_friction",
        "asymmetric_coulomb_friction",
        "stribeck_friction",
        "load_dependent_friction",
        "presliding_friction",
        "thermal_drift",
    },
    {"viscous_friction", "asymmetric_viscous_friction", "damping_gain_error"},
    {
        "torque_offset",
        "asymmetric_coulomb_friction",
        "torque_sensor_error",
        "torque_scale",
        "gravity_compensation_error",
    },
    {"backlash", "transmission_hysteresis", "joint_elasticity"},
    {"command_delay", "measurement_delay", "packet_loss", "actuator_lag", "controller_mismatch"},
    {"armature", "link_inertia"},
    {"torque_saturation", "torque_rate_limit"},
)


@dataclass(frozen=True)
class ArmCase:
    """One arm to be: its kind, of `KINDS`; its faults; seed: of everything random about it.

    In a set of changes faults are what came between two days, always what it had before; day 0: of any other set.
    has_measured_friction: of a set of friction; then it is part of what there is to be found, as the faults are.
    """

    number: int
    kind: str
    faults: tuple[Fault, ...]
    seed: tuple[int, ...]
    always: tuple[Fault, ...] = ()
    day: int = 0
    has_measured_friction: bool = False

    @property
    def noise(self) -> tuple[int, ...]:
        """Seed of the noise of its recording: of each day another."""
        return (*self.seed, 5) if self.day == FIRST_DAY else self.seed

    @property
    def has_six_hinges(self) -> bool:
        """Whether it is the arm that is not a Panda."""
        return self.seed[0] in SIX_HINGES


@dataclass(frozen=True)
class Sizes:
    """Which faults are drawn: times their limits, from least to most."""

    least: float = NEAREST
    most: float = np.inf


def baseline_case(case: ArmCase) -> ArmCase:
    """The arm of a set of changes on the first day."""
    return replace(case, kind="null", faults=(), day=FIRST_DAY)


def draw_cases(count: int, seed: int, which: str) -> list[ArmCase]:
    """`count` cases of one of `SETS`. Kinds, and effects within them, are balanced.

    Of sets of changes the arms on the second day.
    """
    root = (SETS[which], seed)
    if which in CHANGES:
        return _draw_changes(count, root)
    if root[0] in FRICTION:
        return _draw_friction(count, root)
    sizes = Sizes()
    rng = np.random.default_rng([*root, 0])
    exact = np.array(list(KINDS.values())) * count
    numbers = np.floor(exact).astype(int)
    for k in np.argsort(numbers - exact, kind="stable")[: count - numbers.sum()]:
        numbers[k] += 1
    kinds = rng.permutation(np.repeat(list(KINDS), numbers))
    singles, firsts, unknown = _deck(EFFECTS, rng), _deck(EFFECTS, rng), draw_unknown_faults(rng)
    cases = []
    for number, kind in enumerate(kinds):
        own = np.random.default_rng([*root, 1, number])
        if kind == "single":
            faults = (_fault(next(singles), own, sizes),)
        elif kind == "pair":
            faults = _pair(next(firsts), own, sizes)
        elif kind == UNKNOWN_FAULT_KIND:
            name = next(unknown)
            joint = int(own.choice(UNKNOWN_FAULTS[name][1]))
            faults = (Fault(name, joint, _size(own, 3.0, 10.0)),)
        else:
            faults = ()
        cases.append(ArmCase(number, str(kind), faults, (*root, 2, number)))
    return cases


def _draw_changes(count: int, root: tuple[int, int]) -> list[ArmCase]:
    rng = np.random.default_rng([*root, 0])
    kinds = rng.permutation(np.where(np.arange(count) < round(UNCHANGED * count), "null", "single"))
    effects, draw = (six_hinges.EFFECTS, _fault_of_six) if root[0] in SIX_HINGES else (EFFECTS, _fault)
    changes, sizes = _deck(effects, rng), Sizes()
    cases = []
    for number, kind in enumerate(kinds):
        own = np.random.default_rng([*root, 1, number])
        faults = (draw(next(changes), own, sizes),) if kind == "single" else ()
        always: tuple[Fault, ...] = ()
        wanted = own.integers(MOST_ALWAYS + 1)
        while len(always) < wanted:
            fault = draw(str(own.choice(effects)), own, replace(sizes, most=LARGEST_ALWAYS))
            if all(_are_apart(fault, other) for other in (*faults, *always)):
                always += (fault,)
        cases.append(ArmCase(number, str(kind), faults, (*root, 2, number), always, SECOND_DAY))
    return cases


def _draw_friction(count: int, root: tuple[int, int]) -> list[ArmCase]:
    rng = np.random.default_rng([*root, 0])
    kinds = rng.permutation(np.where(np.arange(count) < round(FRICTION_ALONE * count), "friction", "single"))
    effects, cases = _deck(EFFECTS, rng), []
    for number, kind in enumerate(kinds):
        own = np.random.default_rng([*root, 1, number])
        faults = (_fault(next(effects), own, Sizes()),) if kind == "single" else ()
        cases.append(ArmCase(number, str(kind), faults, (*root, 2, number), has_measured_friction=True))
    return cases


def make_physics(cases: list[ArmCase], background: bool = True) -> tuple[Physics, list[list[Parameters]]]:
    """The arms of cases of one set, and of each what exactly its faults are: changes against the arm as it was, where it has two days.

    background: what every arm of the test has (`apply_background`).
    """
    is_six = cases[0].has_six_hinges
    physics = (six_hinges.nominal_physics if is_six else nominal_physics)(len(cases))
    truths = []
    for i, case in enumerate(cases):
        if background:
            apply_background(physics, i, case.seed, six_hinges.READY if is_six else READY)
        if case.has_measured_friction:
            apply_measured_friction(physics, i, case.seed)
        for k, fault in enumerate(case.always):
            own = np.random.default_rng([*case.seed, 6, k])
            if is_six:
                six_hinges.give(physics, i, fault, own)
            else:
                widen(physics, i, fault, apply(physics, i, fault, own), own)
        before = [read_levels(physics, i, fault) for fault in case.faults]
        if case.day == SECOND_DAY:
            apply_session_changes(physics, i, case.seed)
        rng = np.random.default_rng([*case.seed, 1])
        give = six_hinges.give if is_six else apply_unknown_fault if case.kind == UNKNOWN_FAULT_KIND else apply
        truths.append([give(physics, i, fault, rng) for fault in case.faults])
        if not is_six:
            truths[-1] = [widen(physics, i, fault, given, rng) for fault, given in zip(case.faults, truths[-1])]
        if case.day == SECOND_DAY:
            after = [read_levels(physics, i, fault) for fault in case.faults]
            truths[-1] = [change_between_sessions(*both) for both in zip(truths[-1], before, after)]
    return physics, truths


def magnitude(fault: Fault) -> float | None:
    """Of a fault of the catalogue, in the unit of its limit."""
    if isinstance(fault, six_hinges.SixFault):
        return fault.size * six_hinges.limit_of(fault)
    return fault.size * limit_of(fault.effect, fault.joint) if fault.effect in EFFECTS else None


def _deck(names: tuple[str, ...], rng: np.random.Generator):
    """The names in random order, all of them before any comes again."""
    while True:
        yield from (str(name) for name in rng.permutation(names))


def _size(rng: np.random.Generator, least: float, most: float) -> float:
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))


def _fault(effect: str, rng: np.random.Generator, sizes: Sizes) -> Fault:
    joints = [j for j in visible(effect).joints if largest(effect, j - 1) > sizes.least]
    joint = int(rng.choice(joints)) - 1 if joints else None
    return Fault(effect, joint, _size(rng, sizes.least, min(largest(effect, joint), sizes.most)))


def _fault_of_six(effect: str, rng: np.random.Generator, sizes: Sizes) -> Fault:
    joints = six_hinges.LIMITS[effect][1]
    joint = int(rng.choice(joints)) if joints else None
    return six_hinges.SixFault(effect, joint, _size(rng, sizes.least, min(six_hinges.largest(effect), sizes.most)))


def _pair(first: str, rng: np.random.Generator, sizes: Sizes) -> tuple[Fault, Fault]:
    one = _fault(first, rng, sizes)
    while True:
        other = _fault(str(rng.choice(EFFECTS)), rng, sizes)
        if _are_apart(one, other):
            return one, other


def _are_apart(one: Fault, other: Fault) -> bool:
    """Whether two faults of an arm are two effects in any data of its motion."""
    elsewhere = one.joint is not None and other.joint is not None and one.joint != other.joint
    alike = any({one.effect, other.effect} <= group for group in _ALIKE)
    return other.effect != one.effect and (elsewhere or not alike)
