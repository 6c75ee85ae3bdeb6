"""From recordings as they come to logs that can be compared with a nominal arm: torques, of the drives, checked."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.arm.model import Arm
from sim2real.checks.effort_side import convert_to_drive_side
from sim2real.checks.plausibility import check_plausibility
from sim2real.recordings.motor_current import current_to_torque, estimate_torque_constants, mark_as_current
from sim2real.recordings.signals import Log
from sim2real.recordings.speed_lag import correct_speed


def convert_to_torques(logs: Sequence[Log], arm: Arm, effort: str | None = None, reference: int = 0) -> list[Log]:
    """Logs whose efforts are joint torques, each checked for units, signs and the order of joints.

    Motor currents (effort "current", or so marked in the file) become torques by constants that are estimated from the first
    `reference` logs (0: from all). Raises ContractViolation for an implausible log, ValueError where currents do not
    determine the constants.
    """
    logs = [correct_speed(log, arm.joints) for log in logs]
    logs = [mark_as_current(log) if effort == "current" and not log.is_current else log for log in logs]
    currents = [log for log in logs[: reference or None] if log.is_current]
    if currents:
        per_ampere = estimate_torque_constants(currents, arm)
        logs = [current_to_torque(log, per_ampere) if log.is_current else log for log in logs]
    for log in logs:
        check_plausibility(log, arm)
    return logs


def prepare_logs(
    logs: Sequence[Log], arm: Arm, effort: str | None = None, reference: Sequence[Log] = ()
) -> tuple[list[Log], list[Log], Arm]:
    """(logs, reference, arm), all with the same measured torque.

    effort: "drive", "sensor" (after the gear), "current", or None to infer it from the recordings. Raises as `convert_to_torques`.
    """
    together = convert_to_torques([*reference, *logs], arm, effort, len(reference))
    is_current = any(log.per_ampere is not None for log in together)  # a current is the drives'
    together, arm = convert_to_drive_side(together, arm, "drive" if is_current else effort)
    return together[len(reference) :], together[: len(reference)], arm
