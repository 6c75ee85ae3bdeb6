"""What the drive makes of the commanded torque. Shows between command and measurement where the sensor measures it, in the motion where it does not."""
