"""Impedance law, kinematics, trajectories and safety guards as a library; the 500 Hz controller node."""
