"""An object of your own: a YAML file, the task with it, and its scene in MuJoCo."""

from pathlib import Path

from np_description.objects.choice import domain_with
from np_description.scene import load_model

TEXT = """
name: tea box
domain: card                 # whose task and whose policies
size: [0.06, 0.07, 0.006]    # m
mass: 0.012                  # kg
surface: paper               # a row of docs/reference/objects.md
"""

path = Path("tea.yaml")
path.write_text(TEXT)
task = domain_with("card", str(path))
scene = load_model(task)
print("half edges, m:", task.half_size)
print("mass, kg:", round(float(scene.body("object").mass[0]), 4))
print(f"now: make evaluate DOMAIN=card OBJECT={path} EPISODES=20 KEYPOINTS=truth")
