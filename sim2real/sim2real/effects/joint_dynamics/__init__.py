"""Friction in all its forms, rotor, cable, ripple, drift: all show between torque and motion."""
