"""Deviations of the table from its nominal pose."""
