"""From a patch to policies trained with it, with tiny settings: it shows that the commands run, not that the policies improve.

In the patch the arm carries a load and joint 4 has more dry friction. Options go to `finetune`."""

import subprocess
import sys
from pathlib import Path

PATCH = """
effects:
- {effect: payload, component: arm, parameters: {mass: 0.35}}
- {effect: coulomb_friction, component: panda_joint4, parameters: {level: 0.8}}
"""

path = Path("arm.yaml")
path.write_text(PATCH)
tiny = ["--episodes", "2", "--share-episodes", "2", "--minutes", "0.1", "--jobs", "1"]
options = sys.argv[1:] or ["--domain", "wall", "--out", "runs/finetune", *tiny]
sys.exit(subprocess.run(["ros2", "run", "np_evaluation", "finetune", "--patch", str(path), *options]).returncode)
