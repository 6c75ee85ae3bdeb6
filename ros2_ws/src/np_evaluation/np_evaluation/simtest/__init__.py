"""Simulation test: the graph's node classes in one process, over a simulated network, clock, disk and arm, under seeded random faults."""
