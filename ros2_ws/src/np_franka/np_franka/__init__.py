"""A Franka arm and hand behind the topics of docs/reference/graph.md."""
