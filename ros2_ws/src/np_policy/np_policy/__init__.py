"""Pre- and post-contact policies, the approach planner and the episode logic, with their nodes."""
