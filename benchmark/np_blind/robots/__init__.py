"""Whole withheld robots in PhysX: recorded, diagnosed, rehearsed and judged."""
