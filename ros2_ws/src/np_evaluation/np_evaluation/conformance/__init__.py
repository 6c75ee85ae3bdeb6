"""The contract of a backend (docs/reference/graph.md) as checks of a running one."""
