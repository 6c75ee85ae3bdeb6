"""The integer clock: which stamp is a policy tick, and at which an image is due.

All times are integers of nanoseconds, so that no run can drift from another by a rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

from np_description.control_rate import PERIOD_NS as PERIOD
from np_description.control_rate import SECOND


@dataclass(frozen=True)
class Schedule:
    """When ticks and images are due. Raises ValueError for rates that the control period cannot carry."""

    policy_rate: int = 10
    """Divides the control rate of 500 Hz, Hz."""
    image_rate: int = 30
    """At most 500 Hz."""

    def __post_init__(self):
        if self.policy_rate < 1 or SECOND % (self.policy_rate * PERIOD):
            raise ValueError(f"policy_rate: expected a divisor of {SECOND // PERIOD} Hz, got {self.policy_rate}")
        if not 1 <= self.image_rate <= SECOND // PERIOD:
            raise ValueError(f"image_rate: expected 1 .. {SECOND // PERIOD} Hz, got {self.image_rate}")

    @property
    def policy_period(self) -> int:
        """ns between policy ticks."""
        return SECOND // self.policy_rate

    def is_policy_tick(self, stamp: int) -> bool:
        """Whether the policy acts on the state of this stamp (ns)."""
        return stamp % self.policy_period == 0

    def next_policy_tick(self, stamp: int) -> int:
        """The first policy tick (ns) after `stamp`."""
        return (stamp // self.policy_period + 1) * self.policy_period

    def is_image_due(self, stamp: int) -> bool:
        """Whether an image is taken at this stamp (ns): at ticks, and the periods nearest to k/image_rate."""
        if self.is_policy_tick(stamp):
            return True
        index = _nearest(stamp * self.image_rate, SECOND)
        return _nearest(index * SECOND, self.image_rate * PERIOD) * PERIOD == stamp


def _nearest(a: int, b: int) -> int:
    """a / b rounded, halves to the even neighbour."""
    whole, rest = divmod(a, b)
    return whole + (2 * rest > b or (2 * rest == b and whole % 2))
