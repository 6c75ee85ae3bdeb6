"""The MuJoCo backend: stands where the drivers of the robot and of the camera stand."""
