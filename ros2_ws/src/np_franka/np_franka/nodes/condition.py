"""The level and the message of the driver's diagnostics."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from np_control.safety import State

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LEVELS = {State.HOLDING: WARN, State.STOPPED: ERROR, State.FAULT: ERROR}
# ms between the driver's clock and the host's: of a target's 150 to 250 that may pass, and far from it
CLOCK_WARN, CLOCK_ERROR = 20.0, 100.0


def condition(state: State, cause: str, hand: str = "", clock_lag: float = 0.0) -> tuple[bytes, str]:
    """The worst level, and a message that begins with the state.

    cause: of the state; hand: what is wrong with it, or empty; clock_lag: ms that stamps are behind the host's
    clock, which is that of the camera.
    """
    found = [(LEVELS.get(state, OK), f"{state}: {cause}")]
    if hand:
        found.append((WARN, f"hand: {hand}"))
    if abs(clock_lag) > CLOCK_WARN:
        where = "behind" if clock_lag > 0 else "ahead of"
        found.append(
            (ERROR if abs(clock_lag) > CLOCK_ERROR else WARN, f"clock: {abs(clock_lag):.0f} ms {where} the host's")
        )
    return max(level for level, _ in found), "; ".join(words for _, words in found)
