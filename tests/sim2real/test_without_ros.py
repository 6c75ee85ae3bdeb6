"""sim2real alone: what pip installs is all that it imports, and nothing of it needs ROS or torch."""

import ast
import json
import subprocess
import sys

import numpy as np
from arm_generator import Truth, record
from packages import PACKAGES, ROOT, imports, modules, tree
from sim2real.arm import rigid_body as rigid
from sim2real.arm.model import panda

BLOCKED = ("rclpy", "torch", "rosidl", "ament_index_python", "np_ros")

SCRIPT = """
import json, sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top.startswith({blocked!r}) or top.endswith("_msgs"):
            raise ModuleNotFoundError(f"expected no import of {{name}}", name=name)

sys.meta_path.insert(0, Blocker())
from sim2real import diagnose, load_log
diagnosis = diagnose([load_log({path!r})], quick=True)
print(diagnosis.summary())
print(json.dumps([[f.effect.id, f.component] for f in diagnosis.findings if f.is_chosen]))
"""


def test_a_file_is_diagnosed_where_ros_and_torch_are_not_installed(tmp_path):
    log = record(Truth(payload=0.3))
    path = tmp_path / "log.npz"
    torque = log.torque + rigid.gravity_torque(panda(), log.position)
    np.savez(path, t_s=log.torque_time, q_rad=log.position, dq_rad_s=log.velocity, tau_J_Nm=torque)
    script = SCRIPT.format(blocked=BLOCKED, path=str(path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    *summary, chosen = done.stdout.splitlines()
    assert json.loads(chosen) == [["payload", "arm"]] and any(
        line.startswith("payload at arm: p = ") for line in summary
    )


def test_pip_brings_along_every_package_that_is_imported():
    known = modules()
    todo = [name for name in known if name.partition(".")[0] == "sim2real"]
    reached = set(todo)
    while todo:
        for name in imports(known[todo.pop()]):
            if name in known and name not in reached:
                reached.add(name)
                todo.append(name)
    folders = {known[name].parent for name in reached if not name.startswith("sim2real")}
    needed = {".".join(folder.relative_to(ROOT / "ros2_ws/src").parts[1:]) for folder in folders}
    setup = tree(PACKAGES["sim2real"] / "setup.py")
    values = {node.targets[0].id: node.value for node in setup.body if isinstance(node, ast.Assign)}
    assert needed == set(ast.literal_eval(values["BROUGHT_ALONG"]))
