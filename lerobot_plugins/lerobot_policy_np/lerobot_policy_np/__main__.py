"""A folder that LeRobot loads as a policy.

python -m lerobot_policy_np post_contact_card.onnx card FOLDER
"""

import sys
from pathlib import Path

from . import NpConfig, make_np_pre_post_processors

file, domain, folder = sys.argv[1:]
config = NpConfig(file=str(Path(file).resolve()), domain=domain, device="cpu")
Path(folder).mkdir(parents=True, exist_ok=True)
config.save_pretrained(folder)
for pipeline in make_np_pre_post_processors(config):
    pipeline.save_pretrained(folder)
print(folder)
