"""Print requirements.lock: every package that requirements.txt needs, with its version. `make lock` calls this.

Resolved without what is installed already. torch is listed without the name of its build, and the CUDA libraries that
some builds need are left to torch, which pins them itself.
"""

import json
import subprocess
import sys

report = json.loads(
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "-qq",
            "install",
            "--dry-run",
            "--ignore-installed",
            "--report",
            "-",
            "-r",
            "requirements.txt",
        ],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    ).stdout
)
packages = {item["metadata"]["name"]: item["metadata"]["version"].split("+")[0] for item in report["install"]}
print("# Made by `make lock` from requirements.txt with Python {}.{}; do not edit.".format(*sys.version_info[:2]))
for name in sorted(packages, key=str.lower):
    if not name.startswith(("nvidia-", "cuda-", "triton")):
        print(f"{name}=={packages[name]}")
