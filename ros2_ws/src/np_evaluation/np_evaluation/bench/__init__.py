"""Latencies of the graph and its parts."""
