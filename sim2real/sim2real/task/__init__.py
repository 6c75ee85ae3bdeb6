"""The chain beside the arm: clocks of two streams of poses, keypoints at rest, slow pushes and free slides."""
