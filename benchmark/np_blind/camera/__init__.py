"""A camera and a detector of the benchmark's own, and boxes at rest before it."""
