"""ROS nodes of this package: they translate messages, the library half does the work."""
