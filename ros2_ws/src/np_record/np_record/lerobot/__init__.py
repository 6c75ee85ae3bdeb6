"""Recorded episodes as a LeRobot data set, format v3.0, and such data sets as arrays."""
