#!/bin/bash
# Every test that needs no GPU, or those that pytest's arguments choose; `make` sets up what they need. Where CI is set, a test that
# fails beside others on a busy machine is named and repeated once, alone; one that fails again has failed. Where pytest itself ends
# otherwise, the run has failed and nothing is repeated.
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1 MUJOCO_GL=disable
[[ -z ${CI:-} ]] || rm -rf .pytest_cache  # or older failures would be repeated too

failed=0
part() {
    local ended=0
    python -m pytest "$@" || ended=$?
    if [[ $ended = 1 && -n ${CI:-} ]]; then
        echo "=== repeated once, alone: what failed above (a test that passes now depends on time or on others: look into it) ==="
        ended=0
        python -m pytest --last-failed --last-failed-no-failures=none || ended=$?  # pytest died without recording failures: repeats none, fails
    fi
    ((ended <= 1)) || { echo "pytest ended with status $ended: expected 0, or 1 where tests failed" >&2; exit "$ended"; }
    ((ended == 0)) || failed=1
}

if (($#)); then
    part "$@"
    exit $failed
fi
# Three files at a time, for graph tests mostly wait; of graphs in real time one, which has the machine to itself.
# A file whose worker dies is run again by another worker at most twice.
part -n 3 --max-worker-restart 2 --dist loadfile --no-loadscope-reorder -m "not slow and not real_time"
part -m "real_time and not slow"
exit $failed
