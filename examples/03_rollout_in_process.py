"""Episodes with the released policies in one process, without ROS nodes: python examples/03_rollout_in_process.py [TASK] [EPISODES]"""

import sys

from np_description.domains import find_domain
from np_evaluation.in_process import InProcessRollout

task, episodes = (*sys.argv[1:], "wall", "1")[:2] if len(sys.argv) < 3 else sys.argv[1:3]
rollout = InProcessRollout(find_domain(task), "mujoco", seed=1)
for number in range(int(episodes)):
    result = rollout.play(number)
    outcome = "success" if result.success else result.reason or "not at the goal"
    print(f"episode {number}: {outcome}, {1e3 * result.distance:.1f} mm from the goal after {result.duration:.1f} s")
