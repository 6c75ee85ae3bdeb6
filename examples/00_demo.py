"""One episode through the whole graph, with true corners: bag, report and video in runs/. Options go to `demo`."""

import subprocess
import sys

options = sys.argv[1:] or ["--domain", "card", "--episodes", "1", "--keypoints", "truth"]
sys.exit(subprocess.run(["ros2", "run", "np_evaluation", "demo", *options]).returncode)
