"""What every backend owes (docs/reference/graph.md), as checks that can be put to a running one."""
