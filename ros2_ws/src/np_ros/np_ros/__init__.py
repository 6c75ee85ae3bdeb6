"""Shared parts of nodes: quality of service, message translation, node idiom, low-latency spinning."""
