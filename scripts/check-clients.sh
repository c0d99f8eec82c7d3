#!/usr/bin/env bash
# Makes clients of openapi/openapi.json and lets them dance: openapi-python-client (checked by mypy)
# and openapi-typescript with openapi-fetch (checked by tsc), without casts.
#
# usage: scripts/check-clients.sh [BAILANDO [MODEL_DIR [SONG]]]
#   BAILANDO    program, or the address of a server that runs; default target/release/bailando
# Needs python3 with venv, node and npm. What it installs goes to target/clients.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

bailando=${1:-target/release/bailando}
model=${2:-models/default}
song=$(realpath "${3:-tests/fixtures/audio/demo.mp3}")
out=$PWD/target/clients
document=$PWD/openapi/openapi.json
server=
trap '[ -z "$server" ] || kill "$server"' EXIT

install_makers() {
    [ -x "$out/venv/bin/mypy" ] || {
        python3 -m venv "$out/venv"
        "$out/venv/bin/pip" install --quiet --disable-pip-version-check \
            openapi-python-client==0.29.1 ruff mypy
    }
    [ -d "$out/node/node_modules" ] || {
        mkdir -p "$out/node"
        npm install --silent --no-fund --no-audit --prefix "$out/node" \
            openapi-typescript@7.13.0 openapi-fetch@0.17.0 typescript@5.9.3 @types/node@20.19.43
    }
}

# Leaves the address in `address`.
start_server() {
    case $bailando in
    http://* | https://*)
        address=$bailando
        return
        ;;
    esac
    "$bailando" serve --port 0 --json-output --model-dir "$model" > "$out/server.log" 2>&1 &
    server=$!
    for _ in $(seq 300); do
        address=$(sed -n 's|.*"address":"\([^"]*\)".*|http://\1|p' "$out/server.log")
        [ -z "$address" ] || return 0
        kill -0 "$server" || { cat "$out/server.log" >&2; exit 1; }
        sleep 0.1
    done
    echo "check-clients: the server did not start." >&2
    exit 1
}

python_client() {
    rm -rf "$out/bailando_client"
    PATH=$out/venv/bin:$PATH openapi-python-client generate --path "$document" --meta none \
        --output-path "$out/bailando_client" --overwrite > "$out/python-client.log" 2>&1 ||
        { cat "$out/python-client.log" >&2; exit 1; }
    # Types that it does not know are left out of the client, which is no fault of ours.
    if grep -E 'ERROR|will be skipped' "$out/python-client.log"; then exit 1; fi
    cp tests/clients/use.py "$out/use.py"
    (cd "$out" && venv/bin/mypy --strict --follow-imports=silent use.py > mypy.log) ||
        { cat "$out/mypy.log" >&2; exit 1; }
    PYTHONPATH=$out "$out/venv/bin/python" "$out/use.py" "$address" "$song"
}

typescript_client() {
    cp tests/clients/types.mjs tests/clients/use.ts "$out/node/"
    printf '{ "type": "module" }\n' > "$out/node/package.json"
    (
        cd "$out/node"
        node types.mjs "$document" types.ts
        node_modules/.bin/tsc --strict --target es2022 --module nodenext --skipLibCheck \
            --types node use.ts types.ts
        node use.js "$address" "$song"
    )
}

mkdir -p "$out"
install_makers
start_server
python_client
typescript_client
