#!/bin/sh
# Print a Python this project runs on: $PYTHON if given, else the first of the usual places that is 3.11 or 3.12 and
# works (a shim may be on the path and still refuse to run). With ROS 2 sourced it must be that of its packages, 3.12.
wanted="3.11 3.12"
[ -n "$ROS_DISTRO" ] && command -v ros2 > /dev/null && wanted="3.12"
for version in $wanted; do
    for candidate in ${PYTHON:-"python$version" "$HOME/.pyenv/versions/$version".*/bin/python /usr/bin/python3}; do
        found=$("$candidate" -c 'import sys, venv, ensurepip; print("%d.%d" % sys.version_info[:2])' 2> /dev/null)
        if [ "$found" = "$version" ]; then
            command -v "$candidate"
            exit 0
        fi
    done
done
echo "expected Python $wanted with the venv module${PYTHON:+ ($PYTHON was given)}, found none;" \
     "install python3.12-venv, or set PYTHON=/path/to/python" >&2
exit 1
