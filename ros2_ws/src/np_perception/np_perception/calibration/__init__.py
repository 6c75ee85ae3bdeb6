"""Where the camera stands: a board, what recordings show of it, hand-eye calibration, the fit."""
