"""Keypoints of a card that the hand hides in part, as the detector found one in PhysX."""

import numpy as np

CORNERS_OFF = np.array(
    [[-0.3, 1.9], [-0.2, 1.9], [0.7, 1.9], [0.7, 1.8], [-0.1, -0.2], [0.0, -0.3], [0.1, 0.0], [0.2, 0.0]]
)
"""px by which its eight corners were off, with scores of 1: as if it were tilted by .14 rad."""
