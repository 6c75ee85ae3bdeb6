"""The control period that torque commands, safety guards and simulations share."""

SECOND = 1_000_000_000  # ns
PERIOD_NS = 2_000_000
"""The control period, ns: 500 Hz."""
