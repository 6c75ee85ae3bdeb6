#!/bin/bash
# Create .venv and install what requirements.lock lists. `make setup` calls this; it may be run again at any time.
set -euo pipefail
cd "$(dirname "$0")/.."
unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH PYTHONHOME
pip() { .venv/bin/python -m pip --disable-pip-version-check -qq "$@"; }
# Byte code is left to the first import: most of it would never be read.
install=(.venv/bin/python -m pip --disable-pip-version-check install --no-compile --progress-bar off)

python=$(tools/python.sh)
echo "creating .venv with $python ($("$python" --version))"
"$python" -m venv --clear .venv

# torch is the one package with builds to choose from. Without a GPU its CPU build, which is on PyTorch's own index, saves
# 3 GB. TORCH_INDEX= (empty) takes what the configured package index has; so do we where PyTorch's cannot be reached.
if [ -z "${TORCH_INDEX+set}" ]; then
    TORCH_INDEX=https://download.pytorch.org/whl/cpu
    command -v nvidia-smi > /dev/null && TORCH_INDEX=
fi
reachable='import sys, urllib.request; urllib.request.urlopen(sys.argv[1] + "/torch/", timeout=10)'
if [ -n "$TORCH_INDEX" ] && ! .venv/bin/python -c "$reachable" "$TORCH_INDEX" 2> /dev/null; then
    echo "$TORCH_INDEX cannot be reached; taking torch from the default index"
    TORCH_INDEX=
fi
echo "installing torch"
.venv/bin/python tools/pip_progress.py 10 "${install[@]}" ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} "$(grep '^torch==' requirements.lock)"

# Where a ROS 2 installation is sourced, its rclpy and messages are used; two versions in one process would conflict.
lock=requirements.lock
if [ -n "${ROS_DISTRO:-}" ] && command -v ros2 > /dev/null; then
    [ "$ROS_DISTRO" = jazzy ] || { echo "expected ROS 2 jazzy, '$ROS_DISTRO' is sourced" >&2; exit 1; }
    lock=.venv/requirements-without-ros.lock
    grep -v '^ros-' requirements.lock > "$lock"
fi
count=$(grep -c == "$lock")
echo "installing $count packages (one to three minutes)"
# The lock leaves nothing to find out, and pip uses one core: two, with half of it each. Then one that adds what a lock made for
# another Python, or without ROS's own packages, would leave out.
for half in 0 1; do awk "NR % 2 == $half" "$lock" > ".venv/half_$half.lock"; done
.venv/bin/python tools/pip_progress.py "$count" \
    "${install[@]}" --no-deps -r .venv/half_0.lock --and "${install[@]}" --no-deps -r .venv/half_1.lock
pip install --no-compile -r "$lock"
pip check
