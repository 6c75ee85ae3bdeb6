"""The keypoint detector: image to the eight box corners in pixels, with scores."""
