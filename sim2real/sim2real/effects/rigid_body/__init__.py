"""Masses, their places, their inertia, gravity: effects that every joint at and before a link shows."""
