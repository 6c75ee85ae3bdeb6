"""Recordings of the task suite: joints and keypoints on one clock, cut into experiments."""
