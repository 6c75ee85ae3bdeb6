"""`ros2` for machines that have ROS 2 as Python wheels, which come without a command line."""
