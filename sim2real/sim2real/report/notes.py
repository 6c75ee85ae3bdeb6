"""What a reader of the report must know of its recordings: what could not be determined, or was not tried, and why."""

from __future__ import annotations

import numpy as np

from np_description.panda import NOMINAL
from sim2real.diagnosis import Diagnosis


def list_notes(diagnosis: Diagnosis, tried: bool) -> list[str]:
    """Sentences; tried: whether the patch was tried in the closed loop."""
    context, found = diagnosis.context, []
    arm, constants = context.arm, next((log.per_ampere for log in context.logs if log.per_ampere is not None), None)
    if constants is not None:
        each = ", ".join(f"{joint} {value:.3g}" for joint, value in zip(arm.joints, constants) if np.isfinite(value))
        found.append(
            f"Torque is motor current times constants that were estimated from the recording, Nm/A: {each}. Sizes rest on them, and "
            "they on the masses of the model."
        )
        if unknown := [joint for joint, known in zip(arm.joints, context.has_torque) if not known]:
            found.append(
                f"The motion does not determine the constant of {', '.join(unknown)}: these joints are not judged. Record "
                "them under more load, or give torque_per_ampere (`--torque-per-ampere`)."
            )
        if not context.reference:
            found.append(
                "A wrong torque scale of a joint cannot be distinguished from an unknown constant: none is looked for."
            )
    if context.drive is not None and not context.drive.is_replayed:
        found.append(
            "The gains of the controller were not recorded (target_gains): errors of its law are not looked for."
        )
    late = max((log.speed_lag for log in context.logs), default=0.0)
    if late:
        found.append(
            f"The reported speeds are {1e3 * late:.0f} ms late: the derivative of the positions is taken in their place."
        )
    if not tried and diagnosis.verdict != "no_gap":
        found.append(
            f"The patch was not tried in the closed loop ({_reason_untried(diagnosis)}): it is written as found."
        )
    return found


def _reason_untried(diagnosis: Diagnosis) -> str:
    context = diagnosis.context
    if context.reference:
        return "what changed is not seen in a simulator of the nominal arm"
    if context.arm.joints != NOMINAL.joints:
        return "controller and simulator are the Panda's, this is another arm"
    return "no commands were recorded" if context.drive is None else "a quick look does not"
