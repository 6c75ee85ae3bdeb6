"""Deviations of the object from its nominal model."""
