"""The node classes of the graph in one process, over a simulated network, clock, disk and arm, with faults that a seed draws."""
