"""What follows from a diagnosis of the Panda: the next experiment, the patch tried in simulation, and a refit of it there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.diagnosis import Diagnosis
from sim2real.effects.patch import Patch
from sim2real.progress import StageCallback, ignore_stage
from sim2real.simulation.patch_trial import make_patch, try_patch
from sim2real.thresholds import THRESHOLDS


@dataclass(frozen=True)
class Consequences:
    """The patch of a diagnosis, and what was done with it."""

    patch: Patch
    """Effects of the diagnosis that a simulator gets."""
    left_out: Sequence[str] = ()
    """Effects that are not in the patch, since they bring the closed loop no nearer."""
    closed_loop: dict | None = None
    """Departures of the closed loop without and with the patch; None where it was not simulated."""
    experiment: dict | None = None
    """The experiment that would settle the largest open question (`power.choose_next_experiment`)."""
    refit: dict | None = None
    """Parameters refitted in forward simulation (`refit.refit_in_simulation`)."""


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
    patch, left_out, closed_loop = try_patch(diagnosis)
    tell("refit in the simulator")
    rivals = question[1].models[1 : THRESHOLDS.refit.models] if question else ()
    return Consequences(patch, left_out, closed_loop, experiment, refit_in_simulation(diagnosis, rivals))
