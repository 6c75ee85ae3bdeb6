"""Endurance of a graph: many episodes, and malformed messages."""
