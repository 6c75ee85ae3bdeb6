"""The blind benchmark of sim2real: sealed cases of arms (`arm`), task set-ups (`task`) and whole robots (`robots`), and their scores.

No case is made with the inference of the diagnosis. Arms are simulated by a plant of their own, without MuJoCo or Pinocchio; it shares the nominal
numbers of the Panda, the controller's law and limits and the excitation suite with the product. Task set-ups and robots are simulated in PhysX;
robots are judged by the fine-tuning of `np_evaluation`. `sealed` keeps the hashes of all keys, `baselines` holds other identification methods.
"""
