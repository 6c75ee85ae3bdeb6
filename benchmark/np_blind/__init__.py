"""The blind test: arms with a sealed cause, simulated apart from everything the doctor uses, and its score.

Nothing here imports the doctor, MuJoCo or Pinocchio; only NumPy, SciPy, PyYAML and rosbags are needed.
"""
