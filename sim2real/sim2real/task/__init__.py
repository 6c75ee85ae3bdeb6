"""The diagnosis of camera, keypoints, timing, contact, object and table from recordings of the task suite."""
