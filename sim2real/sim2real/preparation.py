"""From recordings as they come to logs that can be compared with a nominal arm: torques, of the drives, checked."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.arm.model import Arm
from sim2real.checks.effort_side import on_the_drives_side
from sim2real.checks.plausibility import check
from sim2real.recordings.current import as_current, as_torque, torque_constants
from sim2real.recordings.signals import Log


def to_torques(logs: Sequence[Log], arm: Arm, effort: str | None = None, reference: int = 0) -> list[Log]:
    """Logs whose efforts are joint torques, each checked for units, signs and the order of joints.

    Motor currents (effort "current", or as the file says) become torques by constants that are estimated from the first
    `reference` logs (0: from all). Raises ContractViolation for an implausible log, ValueError where currents do not
    determine the constants.
    """
    logs = [as_current(log) if effort == "current" and not log.is_current else log for log in logs]
    currents = [log for log in logs[: reference or None] if log.is_current]
    if currents:
        per_ampere = torque_constants(currents, arm)
        logs = [as_torque(log, per_ampere) if log.is_current else log for log in logs]
    for log in logs:
        check(log, arm)
    return logs


def prepare_logs(
    logs: Sequence[Log], arm: Arm, effort: str | None = None, reference: Sequence[Log] = ()
) -> tuple[list[Log], list[Log], Arm]:
    """(logs, reference, arm) that agree on which torque was measured.

    effort: "drive", "sensor" (after the gear), "current", or None to infer it from the recordings. Raises as `to_torques`.
    """
    together = to_torques([*reference, *logs], arm, effort, len(reference))
    is_current = any(log.per_ampere is not None for log in together)  # a current is the drives'
    together, arm = on_the_drives_side(together, arm, "drive" if is_current else effort)
    return together[len(reference) :], together[: len(reference)], arm
