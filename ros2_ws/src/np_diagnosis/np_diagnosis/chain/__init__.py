"""The chain beside the arm: so far the clocks of two streams of poses, and the frames that are missing."""
