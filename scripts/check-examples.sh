#!/usr/bin/env bash
# Runs every example against a server of its own, and says which it leaves out and why.
#
# usage: scripts/check-examples.sh [BAILANDO [SONG]]
#
# BAILANDO is the program (default target/release/bailando). Tools that are used where they are found:
# python3, node with npm, cargo (EXAMPLES_CARGO=1: it compiles for minutes), mcs and mono with
# Newtonsoft.Json (Debian: mono-mcs mono-runtime libmono-system-net-http4.0-cil
# libnewtonsoft-json5.0-cil), godot 4, gdparse (PyPI: gdtoolkit).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

bailando=${1:-target/release/bailando}
song=$(realpath "${2:-tests/fixtures/audio/demo.mp3}")
examples=$PWD/examples
newtonsoft=/usr/lib/cli/Newtonsoft.Json-5.0/Newtonsoft.Json.dll
[ -x "$bailando" ] || { echo "$bailando is not there: make build, or name another" >&2; exit 1; }

work=$(mktemp -d)
: >"$work/server.log"
"$bailando" serve --port 0 2>"$work/server.log" &
server_process=$!
stop() {
    kill "$server_process" 2>/dev/null || true
    wait "$server_process" 2>/dev/null || true
    rm -rf "$work"
}
trap stop EXIT
until grep -q listening "$work/server.log"; do
    kill -0 "$server_process" 2>/dev/null || { cat "$work/server.log" >&2; exit 1; }
    sleep 0.1
done
server=http://$(grep -o '127\.0\.0\.1:[0-9]*' "$work/server.log" | sed -n 1p)

failed=0
skipped=0
# check NAME COMMAND ..: one line where it works, everything that was said where not.
check() {
    local name=$1 status=0
    shift
    set +e # in a condition the shell would ignore failures inside of the command
    (
        set -e
        cd "$work"
        "$@"
    ) >"$work/log" 2>&1
    status=$?
    set -e
    if [ "$status" = 0 ]; then
        printf 'ok    %-11s %s\n' "$name" "$(tail -n 1 "$work/log")"
    else
        printf 'FAIL  %s\n' "$name"
        cat "$work/log"
        failed=$((failed + 1))
    fi
}
skip() {
    printf 'skip  %-11s %s\n' "$1" "$2"
    skipped=$((skipped + 1))
}
has() { command -v "$1" >/dev/null; }

# of_kind FILE PREFIX: whether a file begins as its format does.
of_kind() { [ "$(head -c "${#2}" "$1")" = "$2" ] || { echo "$1 is no such file"; return 1; }; }

python_example() {
    local client=$examples/python/bailando_client.py
    python3 "$client" generate "$song" -o python.glb seed=7 duration_s=8 --server "$server"
    of_kind python.glb glTF
    python3 "$client" job "$song" -o python.bvh duration_s=8 --server "$server"
    of_kind python.bvh HIERARCHY
    # A job that fails says why, as `generate` does.
    echo no song >no-song.mp3
    ! python3 "$client" job no-song.mp3 -o none.bvh --server "$server" 2>python.error || return 1
    tail -n 1 python.error | grep -q '^error: this is not an accepted audio file'
    python3 "$client" stream "$song" duration_s=8 --server "$server" | tee stream.log
    grep -q 'done, 480 frames' stream.log
}

typescript_example() {
    cp -r "$examples/typescript" typescript
    cd typescript
    npm install --no-audit --no-fund --silent
    npx tsc
    node build/main.js "$song" "$server"
    of_kind dance.glb glTF
}

rust_example() {
    (cd "$examples/.." && cargo build --locked --example library --example client)
    local built=${CARGO_TARGET_DIR:-$examples/../target}/debug/examples
    (cd "$examples/.." && "$built/library" "$song" "$work/rust.glb")
    of_kind rust.glb glTF
    "$built/client" "$song" "$server"
    of_kind dance.bvh HIERARCHY
}

unity_example() {
    cp "$newtonsoft" .
    mcs -langversion:7 -warn:4 -warnaserror -out:Check.exe -r:System.Net.Http.dll \
        -r:"$newtonsoft" "$examples"/unity/Bailando/*.cs "$examples"/unity/check/*.cs
    mono Check.exe "$server" "$song"
}

gdscript_example() {
    gdparse "$examples"/godot/*.gd
    echo "parsed, not run"
}

godot_example() {
    godot --headless --path "$examples/godot" --script check.gd -- "$server" "$song"
}

unreal_example() {
    python3 "$examples/unreal/import_dance.py" "$song" "$server"
}

if has python3; then
    check python python_example
    check unreal unreal_example
else
    skip python "python3 is not installed"
    skip unreal "python3 is not installed"
fi
if has node && has npm; then
    check typescript typescript_example
else
    skip typescript "node and npm are not installed"
fi
if [ -n "${EXAMPLES_CARGO:-}" ]; then
    check rust rust_example
else
    skip rust "compiles for minutes (EXAMPLES_CARGO=1); make test compiles it, too"
fi
if has mcs && has mono && [ -f "$newtonsoft" ]; then
    check unity unity_example
    skip "unity run" "Unity itself: its classes are replaced by stand-ins"
else
    skip unity "mono or Newtonsoft.Json is not installed"
fi
if has gdparse; then
    check gdscript gdscript_example
else
    skip gdscript "gdtoolkit is not installed"
fi
if has godot && [[ $(godot --version) == 4.* ]]; then
    check godot godot_example
else
    skip godot "Godot 4 is not installed"
fi
skip "unreal run" "Unreal Editor: outside it the script only fetches its file"

echo "$failed failed, $skipped left out"
[ "$failed" = 0 ]
