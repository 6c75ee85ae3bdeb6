"""What follows from a diagnosis of the Panda: the next experiment, the patch tried in simulation, and a refit of it there."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.arm_numbers import ArmNumber, estimate_arm_numbers
from sim2real.diagnosis import Diagnosis
from sim2real.effects.patch import Patch
from sim2real.progress import StageCallback, ignore_stage
from sim2real.simulation.patch_trial import PatchTrial, make_patch, try_patch
from sim2real.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Consequences:
    """The patch of a diagnosis, and what was done with it."""

    patch: Patch
    """Effects of the diagnosis that a simulator gets."""
    trial: PatchTrial | None = None
    """The patch in simulation, on held-out motion where there is any; None where it was not simulated."""
    experiment: dict | None = None
    """The experiment that would settle the largest open question (`power.choose_next_experiment`)."""
    refit: dict | None = None
    """Parameters refitted in forward simulation (`refit.refit_in_simulation`)."""
    arm: tuple[ArmNumber, ...] = ()
    """Load, base and friction of the arm, named by the diagnosis or not."""


def follow_up(diagnosis: Diagnosis, quick: bool = False, tell: StageCallback = ignore_stage) -> Consequences:
    """The patch and its trial; of a quick look, or of a change between recordings, the patch alone.

    A change since earlier recordings does not show in a simulator of the nominal arm.
    """
    if quick or diagnosis.context.reference:
        return Consequences(make_patch(diagnosis))
    # Simulators and planners take a second to import, which a quick look has not.
    from sim2real.excitation.ambiguity import find_open_question
    from sim2real.excitation.power import choose_next_experiment
    from sim2real.simulation.refit import refit_in_simulation

    tell("next experiment")
    question = find_open_question(diagnosis)
    experiment = choose_next_experiment(diagnosis, question)
    tell("the patch in the simulator")
    patch, trial = try_patch(diagnosis)
    tell("refit in the simulator")
    rivals = question[1].models[1 : THRESHOLDS.refit.models] if question else ()
    refit = refit_in_simulation(diagnosis, rivals)
    return Consequences(patch, trial, experiment, refit, tuple(estimate_arm_numbers(diagnosis)))
