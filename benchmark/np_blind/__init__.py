"""The blind test: arms with a sealed cause, simulated apart from everything the doctor uses, and its score.

Nothing here uses the doctor's inference, MuJoCo or Pinocchio. From the robot's packages it takes numbers of the nominal
Panda, the controller's law and limits, the excitation suite, and what commands share.
"""
