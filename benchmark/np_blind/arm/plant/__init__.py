"""The arms of the blind test: their own physics, nothing of it shared with the diagnosis or the simulators."""
