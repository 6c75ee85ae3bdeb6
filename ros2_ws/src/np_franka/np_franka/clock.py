"""The driver's clock: it goes as the robot's does, and is led towards the host's. No ROS.

Stamps go with the robot's clock, because derivatives of states require their true distances in time. Targets
carry the host's time, that of the camera's images, and 100 ppm are 150 ms after 25 minutes. So the origin
follows the host's clock, by no more than quartz may be off: stamps have no step. A state cannot arrive before it
was taken. So the earliest of many arrivals gives the offset of the two clocks, however late the others are.
"""

from __future__ import annotations

from math import inf

WINDOW = 1_000_000_000  # ns, of which the earliest arrival counts
SLEW = 200e-6  # s/s: two clocks of 100 ppm each, and a cycle of the robot is 0.2 us longer or shorter


class RobotClock:
    """Times are ns. stamp: the newest, growing strictly; lag: how far stamps are behind the host's clock, by the
    earliest arrival of the last window; 0 before the first has passed.
    """

    def __init__(self):
        self.stamp = self.lag = 0

    def begin(self, time: int, arrival: int, after: int) -> int:
        """The stamp of the first state of a connection, `time` on the robot's clock, that came at `arrival` on the
        host's: its arrival, but at least `after` later than any stamp before."""
        self.stamp = max(arrival, self.stamp + after)
        self.lag = 0
        self._origin, self._time, self._rate = self.stamp - time, time, 0.0
        self._forget()
        return self.stamp

    def go_on(self, time: int, arrival: int) -> int:
        """The stamp of the next state, of a later `time`."""
        self._origin += round(self._rate * (time - self._time))
        self._time, self.stamp = time, time + self._origin
        self._least = min(self._least, arrival - time)
        if time >= self._window_end:
            self.lag = self._least - self._origin
            self._rate = max(-SLEW, min(SLEW, self.lag / WINDOW))
            self._forget()
        return self.stamp

    def _forget(self) -> None:
        self._least, self._window_end = inf, self._time + WINDOW
