"""What is wrong with keypoints once the image is there."""
