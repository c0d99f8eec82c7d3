#!/usr/bin/env bash
# Runs a `cargo test .. -- --show-output` and closes with one line over all of its test binaries:
#   P passed, F failed, S skipped
# A test that needs something this machine does not have prints a line `skipped: <why>` and returns;
# libtest counts it as passed and hides the line. Here it counts as skipped, as do ignored tests. The
# output of passing tests goes to the log alone, failures are shown in full, and the status is that of
# the command.
#
# Usage: scripts/test-summary.sh LOG COMMAND [ARGUMENT ..]
set -euo pipefail

if [ $# -lt 2 ]; then
    echo "usage: $0 LOG COMMAND [ARGUMENT ..]" >&2
    exit 2
fi
log=$1
shift
mkdir -p "$(dirname "$log")"

# Hides libtest's `successes:` sections, but for the lines that say what was skipped.
show() {
    local line hidden=false
    while IFS= read -r line || [ -n "$line" ]; do
        case "$line" in
        'successes:') hidden=true ;;
        'failures:' | 'test result: '*) hidden=false ;;
        esac
        if [ "$hidden" = false ] || [[ $line == 'skipped: '* ]]; then
            printf '%s\n' "$line"
        fi
    done
}

# Adds up the `test result:` lines; a test's own output follows its line `---- name stdout ----`.
summarise() {
    awk -v status="$1" '
        /^---- .* stdout ----$/ { counted = 0 }
        /^successes:$/ { succeeding = 1 }
        /^failures:$/ { succeeding = 0 }
        /^skipped: / && succeeding && !counted { counted = 1; skipped++ }
        /^test result: / {
            succeeding = 0
            for (i = 2; i <= NF; i++) {
                if ($i == "passed;") passed += $(i - 1)
                if ($i == "failed;") failed += $(i - 1)
                if ($i == "ignored;") ignored += $(i - 1)
            }
        }
        END {
            if (status != 0 && failed == 0) {
                print "The run ended with status " status " without a failed test (a build " \
                    "error or a crash, see above): counted as one failure."
                failed = 1
            }
            printf "%d passed, %d failed, %d skipped\n", passed - skipped, failed, skipped + ignored
        }' "$log"
}

status=0
"$@" 2>&1 | tee "$log" | show || status=$?
echo
echo "Full output: $log"
summarise "$status"
exit "$status"
