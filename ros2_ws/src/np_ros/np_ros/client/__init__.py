"""Nodes in a command's own process that observe a graph and call its services."""
