"""The nominal arm: its tree of hinges, rigid-body dynamics, the stages between target and motion."""
