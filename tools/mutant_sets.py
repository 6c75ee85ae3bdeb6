"""What `make mutants` draws from: sets of modules, and the tests that have to notice a fault in them."""

SOURCES, TRAINING = "ros2_ws/src", "training/np_training"
CONTROL = (
    f"{SOURCES}/np_control/np_control/*.py",
    f"{SOURCES}/np_control/np_control/safety/*.py",
    f"{SOURCES}/np_policy/np_policy/action.py",
    f"{SOURCES}/np_policy/np_policy/episode*.py",
    f"{SOURCES}/np_policy/np_policy/observation.py",
    f"{SOURCES}/np_franka/np_franka/arm.py",
    f"{SOURCES}/np_franka/np_franka/driver.py",
)
LEARNER = (f"{TRAINING}/ppo/learner.py", f"{TRAINING}/ppo/curriculum.py", f"{TRAINING}/tasks/rewards.py")
OF_CONTROL = (
    "np_control/test_*.py",
    "np_franka/test_franka_driver.py",
    "np_franka/test_franka_onboard.py",
    "np_franka/test_numbers.py",
    "np_policy/test_contract.py",
    "np_policy/test_episode*.py",
    "np_policy/test_policy.py",
    "np_planning/test_ros2_control.py",
)
OF_TRAINING = (
    "np_training/test_comparisons.py",
    "np_training/test_curriculum.py",
    "np_training/test_distillation.py",
    "np_training/test_forces.py",
    "np_training/test_learning.py",
    "np_training/test_networks.py",
    "np_training/test_object_choice.py",
    "np_training/test_policies.py",
    "np_training/test_practice.py",
    "np_training/test_re*.py",
    "np_training/test_run.py",
    "np_training/test_sizes.py",
    "np_training/test_tasks.py",
    "np_training/test_trainer.py",
    "np_training/test_whitening.py",
)
SETS = {
    "control": (CONTROL, OF_CONTROL),
    "learner": (LEARNER, OF_TRAINING),
    "training": ((*LEARNER, f"{TRAINING}/ppo/*.py"), OF_TRAINING),
}
"""Modules and their tests, as patterns."""
ELSEWHERE = ("__init__.py", "captured.py", "distributed.py")  # only a GPU or several processes execute the last two
