"""The blind test on sealed cases: arms (`arm`), what is beside the arm (`chain`), whole robots (`robots`), and their scores.

No case is made with the doctor's inference. Arms are simulated apart from everything that the doctor uses, without MuJoCo or
Pinocchio: from the robot's packages that takes numbers of the nominal Panda, the controller's law and limits, the excitation
suite, and what commands share. For tasks and robots reality is PhysX; robots are judged by `np_bringup`'s rehearsal itself.
`camera` asks two stages of the chain by themselves; `sealed` puts down the hashes of all keys.
"""
