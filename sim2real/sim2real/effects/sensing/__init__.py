"""Encoders and torque sensors that are off."""
