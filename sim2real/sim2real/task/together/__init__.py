"""All stages of the chain together: one answer of one set-up, a row each for camera, keypoints, timing, arm, contact, object and table."""
