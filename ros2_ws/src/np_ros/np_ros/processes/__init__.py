"""A graph as processes of this machine: the table of its nodes, their start and end, locks, the ROS domain."""
