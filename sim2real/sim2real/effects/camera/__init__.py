"""Where the camera is, what its lens does, and when its images were taken."""
