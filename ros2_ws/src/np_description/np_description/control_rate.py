"""The control period that torque commands, safety guards and simulations share."""

SECOND_NS = 1_000_000_000
PERIOD_NS = 2_000_000
"""The control period, ns: 500 Hz."""
