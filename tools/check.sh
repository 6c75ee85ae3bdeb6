#!/bin/sh
# Checks whether this checkout can be set up where it is. If not, prints the reason, before minutes of installing. `make setup` calls this.
root=$(cd "${1:-$(dirname "$0")/..}" && pwd) || exit 1
case $root in
    *[[:space:]]*)
        echo "make setup: expected a path without spaces, got '$root': scripts of venv and colcon name their interpreter" \
             "by its path, which may hold none; move the clone" >&2
        exit 1 ;;
esac
for name in .venv .venv-franka-sim; do
    if [ -L "$root/$name" ]; then
        echo "make setup: expected $name to be a folder of this checkout, or not there yet; it is a link to" \
             "$(readlink "$root/$name"), which an installation would empty; remove the link" >&2
        exit 1
    fi
done
if ! (probe=$(mktemp "$root/.writable.XXXXXX") && rm "$probe") 2> /dev/null; then
    echo "make setup: expected a checkout that can be written, cannot make a file in $root: read-only, full, or another" \
         "user's; clone it where you can write" >&2
    exit 1
fi
