#!/usr/bin/env bash
# Builds and tests the container image on a machine that can run neither docker nor podman and reaches
# no image registry (a virtual machine for continuous integration, a sandbox).
#
# buildah executes the real Dockerfile, isolated by chroot alone. Stand-ins replace its two base images:
# Debian by debootstrap from this machine's mirror, and on it, for the builder, this machine's Rust
# toolchain. The script then starts the result as the image says (user, environment, working folder,
# command) in a read-only root, requests a dance, and measures it.
#
# Usage: scripts/rehearse-image.sh [--work DIR] [--song FILE] [--device DEVICE] [--no-server]
#   --work DIR       scratch folder, 3 GB, 9 GB for cuda (default: target/image-rehearsal)
#   --song FILE      the song (default: tests/fixtures/audio/demo.mp3)
#   --device DEVICE  the variant: cpu or cuda, whose server wants a GPU (default: cpu)
#   --no-server      build and measure only
# Needs root, Debian or Ubuntu, and: debootstrap buildah curl python3 cargo
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

suite=bookworm
debian_image=docker.io/library/debian:bookworm-slim
image=localhost/bailando-rehearsal
work=target/image-rehearsal
song=tests/fixtures/audio/demo.mp3
device=cpu
try_server=true
url=http://127.0.0.1:8080
job= # the running server, as this shell's child

fail() {
    printf 'rehearse-image: %s\n' "$1" >&2
    exit 1
}

say() {
    printf '\n== %s\n' "$1"
}

storage() {
    buildah --root "$work/storage" --runroot "$work/run" "$@"
}

check_tools() {
    [ "$(id -u)" = 0 ] || fail "must run as root (debootstrap, mount, chroot)."
    local tool
    for tool in debootstrap buildah curl python3 cargo unshare; do
        command -v "$tool" >/dev/null || fail "$tool is missing: apt-get install debootstrap buildah \
curl python3 util-linux; cargo from https://rustup.rs"
    done
}

# Prints the mirror that this machine's own apt uses; nothing where it has none for the suite.
mirror() {
    # shellcheck disable=SC2016 # apt fills the field in
    apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' "Codename: $suite" \
        'Origin: Debian' 'Component: main' 2>/dev/null | sed -n 1p
}

make_debian() {
    storage inspect "$debian_image" >/dev/null 2>&1 && return
    say "stand-in for $debian_image"
    rm -rf "$work/debian"
    # shellcheck disable=SC2046 # an empty mirror must vanish
    debootstrap --variant=minbase "$suite" "$work/debian" $(mirror) >"$work/debootstrap.log" ||
        fail "debootstrap failed: see $work/debootstrap.log"
    # The `slim` images leave out manuals, documentation and translations, but keep the licences.
    find "$work/debian/usr/share/doc" -type f ! -name copyright -delete
    rm -rf "$work/debian/usr/share/"{man,info,locale}/* "$work/debian/var/lib/apt/lists/"* \
        "$work/debian/var/cache/apt/"* "$work/debian/dev" "$work/debian/var/log/"*.log
    mkdir "$work/debian/dev"
    # As in the official images: apt keeps no packages and no binary caches (77 MB).
    cat >"$work/debian/etc/apt/apt.conf.d/docker-clean" <<'CONF'
DPkg::Post-Invoke { "rm -f /var/cache/apt/archives/*.deb || true"; };
Dir::Cache::pkgcache "";
Dir::Cache::srcpkgcache "";
CONF
    tar -C "$work/debian" -cf "$work/debian.tar" .
    rm -rf "$work/debian"
    local container
    container=$(storage from scratch)
    storage add --quiet "$container" "$work/debian.tar" / >/dev/null
    storage config --cmd bash "$container"
    storage commit --quiet --rm "$container" "$debian_image" >/dev/null
    rm "$work/debian.tar"
}

make_rust() {
    local rust_image
    rust_image=docker.io/library/$(sed -n 's/^FROM \(rust:[^ ]*\) AS builder/\1/p' Dockerfile)
    storage inspect "$rust_image" >/dev/null 2>&1 && return
    say "stand-in for $rust_image: $(rustc --version) of this machine"
    tar -C "$(rustc --print sysroot)" --exclude=./share -cf "$work/rust.tar" .
    local container
    container=$(storage from --pull-never "$debian_image")
    storage run --isolation chroot "$container" -- sh -c 'apt-get update -qq &&
        apt-get install -qq --yes --no-install-recommends ca-certificates gcc libc6-dev make' \
        >"$work/rust.log" 2>&1 || fail "apt-get failed: see $work/rust.log"
    storage add --quiet "$container" "$work/rust.tar" /usr/local/rust >/dev/null
    storage config --env CARGO_HOME=/usr/local/cargo \
        --env PATH=/usr/local/rust/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin \
        "$container"
    storage commit --quiet --rm "$container" "$rust_image" >/dev/null
    rm "$work/rust.tar"
}

# Collects the settings of a machine behind a mirror or a proxy: certificates, cargo's and pip's
# settings. The build steps get them as mounts, so that none of them ends in the image.
collect_settings() {
    local cargo_home=${CARGO_HOME:-$HOME/.cargo}
    rm -rf "$work/settings"
    mkdir -p "$work/settings/cargo/registry"
    cp -aL /etc/ssl/certs "$work/settings/certs"
    local file
    for file in config.toml config; do
        [ ! -f "$cargo_home/$file" ] || cp "$cargo_home/$file" "$work/settings/cargo/"
    done
    # Both folders: installing `ca-certificates` rebuilds the first from the second.
    settings=(--volume "$work/settings/certs:/etc/ssl/certs"
        --volume /usr/local/share/ca-certificates:/usr/local/share/ca-certificates:ro
        --volume "$work/settings/cargo:/usr/local/cargo")
    # Crates that are here already need no second download.
    [ ! -d "$cargo_home/registry" ] ||
        settings+=(--volume "$cargo_home/registry:/usr/local/cargo/registry")
    [ ! -f /etc/pip.conf ] || settings+=(--volume /etc/pip.conf:/etc/pip.conf:ro)
}

build_image() {
    say "Dockerfile"
    collect_settings
    storage bud --isolation chroot --pull-never --layers --format docker "${settings[@]}" \
        --build-arg DEVICE="$device" --tag "$image" . 2>&1 | tee "$work/build.log"
}

# Prints the items of a Python expression over the image's configuration, one on each line.
image_setting() {
    storage inspect --type image "$image" | python3 -c "
import json, sys
config = json.load(sys.stdin)['Docker']['config']
print('\n'.join($1))"
}

mount_image() {
    local container
    container=$(storage from --pull-never "$image")
    root=$(storage mount "$container")
}

measure_root() {
    say "the image's root"
    du -sxh "$root" | cut -f 1
    du -xh --apparent-size "$root/usr/local/bin/bailando" "$root/usr/local/lib/libonnxruntime.so" \
        "$root/app/models/default" | sed "s#$root##"
    local tool
    for tool in cc gcc ld cargo rustc python3 perl5 pip make; do
        [ ! -e "$root/usr/bin/$tool" ] && [ ! -e "$root/usr/local/bin/$tool" ] ||
            fail "$tool is in the final image."
    done
    echo "no compiler, no Python"
    local missing
    missing=$(chroot "$root" ldd /usr/local/bin/bailando /usr/local/lib/libonnxruntime.so |
        grep 'not found' || true)
    [ -z "$missing" ] || fail "shared libraries are missing: $missing"
}

# Runs a command as the image would: with its user, environment and folder, and nothing writable.
inside() {
    local user folder environment
    user=$(image_setting '[config["User"]]')
    folder=$(image_setting '[config["WorkingDir"]]')
    mapfile -t environment < <(image_setting 'config["Env"]')
    # shellcheck disable=SC2016 # the inner shell expands them
    unshare --mount --pid --fork --kill-child bash -c '
        set -e
        root=$1 user=$2 folder=$3
        shift 3
        mount --bind "$root" "$root"
        mount -t proc proc "$root/proc"
        mount -o remount,bind,ro "$root"
        exec chroot --userspec="$user" "$root" env -i --chdir="$folder" "$@"
    ' rehearsal "$root" "$user" "$folder" "${environment[@]}" "$@"
}

# The innermost child of the job: the server itself, below this shell and unshare.
server_pid() {
    local pid=$job child
    while child=$(pgrep --parent "$pid" | sed -n 1p) && [ -n "$child" ]; do
        pid=$child
    done
    echo "$pid"
}

stop_server() {
    kill -TERM "$(server_pid)"
}

# The images stay, so that a second rehearsal starts from their layers.
clean_up() {
    if [ -n "$job" ]; then
        stop_server || true
        wait "$job" || true
    fi
    storage rm --all >/dev/null
}

show_memory() {
    awk -v when="$1" '/^VmRSS|^VmHWM/ { printf "%s: %s %.0f MB\n", when, $1, $2 / 1024 }' \
        "/proc/$(server_pid)/status"
}

probe() {
    local command
    mapfile -t command < <(image_setting 'config["Healthcheck"]["Test"][1:]')
    inside "${command[@]}"
}

run_server() {
    say "the server, non-root in a read-only root"
    ! curl --silent --output /dev/null "$url" || fail "something else answers at $url."
    local command attempt
    mapfile -t command < <(image_setting 'config["Entrypoint"] + config["Cmd"]')
    inside "${command[@]}" >"$work/server.log" 2>&1 &
    job=$!
    for attempt in $(seq 60); do
        probe >/dev/null 2>&1 && break
        kill -0 "$job" 2>/dev/null || fail "the server ended: $(tail -n 5 "$work/server.log")"
        [ "$attempt" -lt 60 ] || fail "the healthcheck fails: see $work/server.log"
        sleep 0.5
    done
    echo "healthcheck: passes"
    # Alive is not ready: the model is loaded after the port is open.
    curl --silent --fail --output /dev/null --retry 30 --retry-delay 1 "$url/ready" ||
        fail "the server does not get ready: see $work/server.log"
    grep '^Uid' "/proc/$(server_pid)/status"
    show_memory idle
    ask "$song" json
    ask "$song" bvh
    show_memory 'after two dances'
    stop_server
    local status=0
    wait "$job" || status=$?
    job=
    [ "$status" = 0 ] || fail "the server ended with status $status on SIGTERM."
    echo "SIGTERM: ended with status 0"
    ! probe 2>/dev/null || fail "the healthcheck passes without a server."
    echo "healthcheck without a server: fails, as it should"
}

ask() {
    curl --silent --show-error --fail-with-body --output "$work/dance.$2" \
        --write-out "POST /generate format=$2: %{http_code}, %{size_download} bytes, %{time_total} s\n" \
        --form "file=@$1" "$url/generate?format=$2&seed=1" ||
        fail "no dance: $(head -c 400 "$work/dance.$2")"
    python3 - "$work/dance.$2" <<'PYTHON' || fail "$work/dance.$2 is not a dance."
import json, re, sys
text = open(sys.argv[1]).read()
if sys.argv[1].endswith(".json"):
    dance = json.loads(text)
    frames, rows = dance["frames"], len(dance["positions"])
else:
    motion = text.split("MOTION", 1)[1]
    frames = int(re.search(r"Frames:\s*(\d+)", motion).group(1))
    rows = len(motion.strip().splitlines()) - 2
print(f"  {frames} frames")
sys.exit(not 0 < frames == rows)
PYTHON
}

while [ $# -gt 0 ]; do
    case "$1" in
    --work) work=${2:?--work needs a folder} && shift 2 ;;
    --song) song=${2:?--song needs a file} && shift 2 ;;
    --device) device=${2:?--device needs one} && shift 2 ;;
    --no-server) try_server=false && shift ;;
    *) fail "unknown option '$1'." ;;
    esac
done
check_tools
mkdir -p "$work"
work=$(cd "$work" && pwd)
trap clean_up EXIT
make_debian
make_rust
build_image
mount_image
measure_root
[ "$try_server" = false ] || run_server
say "rehearsal passed"
