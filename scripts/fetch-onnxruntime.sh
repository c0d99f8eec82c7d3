#!/bin/sh
# Fetches the ONNX Runtime shared library that bailando loads at run time.
#
# The library comes out of the official PyPI wheel, because people behind a mirror or a proxy have pip
# configured already. Both the wheel and the library in it are pinned by SHA-256: nothing else is ever
# installed.
#
# Usage: scripts/fetch-onnxruntime.sh [--cuda] [--dest DIR]
#   --cuda       the library with NVIDIA's of CUDA 13 and cuDNN 9 beside it, for --device cuda
#                (Linux x86_64, 1.4 GB to download, 2.0 GB on the disk)
#   --dest DIR   where to install (default: .onnxruntime in the project, .onnxruntime/cuda for --cuda)
# Result: DIR/lib/libonnxruntime.so (.dylib on macOS), licences in DIR, those of NVIDIA in DIR/nvidia
set -eu

version=1.32.0
package=onnxruntime
python_tag=3.12 # of the wheel; the library in it does not depend on Python

fail() {
    printf 'fetch-onnxruntime: %s\n' "$1" >&2
    exit 1
}

usage() {
    sed -n '/^# Usage/,/^# Result/s/^# \{0,1\}//p' "$0"
}

# Sets wheel_platform, wheel_sha256, member, library, library_sha256.
# A new version: `pip download` each wheel, hash it and the library in it, replace both columns.
select_platform() {
    case "$1" in
    Linux-x86_64)
        wheel_platform=manylinux_2_28_x86_64
        wheel_sha256=99e1074c4b2197accd5073052a465361be17b89c093b8ffb6e6bd8f986c52df8
        library_sha256=6c1585d1bbf45b0712ea4a21b705c5fcb4ba04ff2e30f1fbf81a49faf658638f
        ;;
    Linux-aarch64 | Linux-arm64)
        wheel_platform=manylinux_2_28_aarch64
        wheel_sha256=e36c187006e7a7c8b8d6d57f1a209dd63f52430dca6c282b177718ad6b841054
        library_sha256=49852228a93995158b2a813d4df487d47a1b76b0eaa894507ef49e91b6d7954a
        ;;
    Darwin-arm64)
        wheel_platform=macosx_14_0_arm64
        wheel_sha256=d52510bbbcc880c13b826f7d75cdf33ac5cf0bb864d960000fc29ce73f0cb83e
        library_sha256=fa585fabbea65b823b9a8f7e27d46aee3989d1be7e36b528203d3a1fd613aae7
        ;;
    Darwin-x86_64)
        fail "ONNX Runtime $version has no wheel for Macs with Intel processors.
Build libonnxruntime.dylib yourself and set ORT_DYLIB_PATH to it."
        ;;
    MINGW* | MSYS* | CYGWIN*)
        fail "Windows is not supported directly: use WSL, or set ORT_DYLIB_PATH to the
onnxruntime.dll of 'pip install onnxruntime==$version'."
        ;;
    *)
        fail "no ONNX Runtime wheel is pinned for this platform ($1).
Supported: Linux x86_64, Linux aarch64, macOS 14 or newer arm64.
Elsewhere, build ONNX Runtime $version and set ORT_DYLIB_PATH to its shared library."
        ;;
    esac
    case "$1" in
    Darwin-*) library=libonnxruntime.dylib member=onnxruntime/capi/libonnxruntime.$version.dylib ;;
    *) library=libonnxruntime.so member=onnxruntime/capi/libonnxruntime.so.$version ;;
    esac
}

# The library with CUDA has versions of its own.
select_cuda() {
    [ "$1" = Linux-x86_64 ] || fail "--cuda is for Linux x86_64, this is $1."
    version=1.31.1
    package=onnxruntime-gpu
    wheel_platform=manylinux_2_28_x86_64
    wheel_sha256=05d548956197b9d01f59b625de740e0d6be3593f874e241a12dc0362650ecdf7
    library=libonnxruntime.so
    member=onnxruntime/capi/libonnxruntime.so.$version
    library_sha256=5104254339ecadae808da771bd0b63b240f0dbd466514234905e54372435c303
}

# What the provider needs of NVIDIA's, for pip, which checks the hashes. The first of CUDA 13, so that
# every driver from 580 on will do.
nvidia_wheels() {
    cat <<'WHEELS'
nvidia-cublas==13.1.0.3 --hash=sha256:ee8722c1f0145ab246bccb9e452153b5e0515fd094c3678df50b2a0888b8b171
nvidia-cuda-nvrtc==13.0.88 --hash=sha256:ad9b6d2ead2435f11cbb6868809d2adeeee302e9bb94bcf0539c7a40d80e8575
nvidia-cuda-runtime==13.0.96 --hash=sha256:7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548
nvidia-cudnn-cu13==9.28.1.4 --hash=sha256:a54f205b1db1f2895d99f398754db1369816f0569dd459731f925635cf7b65ec
nvidia-curand==10.4.0.35 --hash=sha256:1aee33a5da6e1db083fe2b90082def8915f30f3248d5896bcec36a579d941bfc
WHEELS
}

# The wheel's own platform tag promises these; the loader's message without them is unreadable.
check_system() {
    case "$1" in
    Linux-*)
        libc=$(getconf GNU_LIBC_VERSION 2>/dev/null) || libc=
        [ -n "$libc" ] || fail "the library needs glibc 2.28 or newer, and this system has another
C library (Alpine's musl?). Use a glibc system such as Debian 12."
        minor=${libc#glibc 2.}
        [ "${minor%%[!0-9]*}" -ge 28 ] || fail "the library needs glibc 2.28 or newer, found $libc."
        ;;
    Darwin-*)
        release=$(sw_vers -productVersion)
        [ "${release%%.*}" -ge 14 ] || fail "the library needs macOS 14 or newer, found $release."
        ;;
    esac
}

check_python() {
    command -v python3 >/dev/null 2>&1 || fail "python3 is needed to download the library.
  Debian, Ubuntu: sudo apt-get install python3 python3-pip
  Fedora:         sudo dnf install python3 python3-pip
  macOS:          brew install python"
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 8))' ||
        fail "Python 3.8 or newer is needed, found $(python3 --version 2>&1)."
    python3 -m pip --version >/dev/null 2>&1 || fail "pip is missing ('python3 -m pip' fails).
  Debian, Ubuntu: sudo apt-get install python3-pip
  Fedora:         sudo dnf install python3-pip
  macOS, others:  python3 -m ensurepip"
}

sha256() {
    if command -v sha256sum >/dev/null 2>&1; then
        sha256sum "$1"
    elif command -v shasum >/dev/null 2>&1; then
        shasum -a 256 "$1"
    else
        python3 -c 'import hashlib, sys
print(hashlib.sha256(open(sys.argv[1], "rb").read()).hexdigest())' "$1"
    fi | cut -d ' ' -f 1
}

expect_sha256() {
    found=$(sha256 "$1")
    [ "$found" = "$2" ] || fail "$3 has the wrong checksum, nothing was installed.
  expected $2
  found    $found
A proxy or mirror may have answered with something else: try again, or check PIP_INDEX_URL."
}

# The library is moved into place last of all.
is_installed() {
    [ -z "$cuda" ] || [ -d "$dest/nvidia" ] || return 1
    [ -f "$dest/LICENSE" ] && [ -f "$dest/ThirdPartyNotices.txt" ] &&
        [ -f "$dest/lib/$library" ] && [ "$(sha256 "$dest/lib/$library")" = "$library_sha256" ]
}

download() {
    python3 -m pip download --quiet --no-deps --only-binary=:all: \
        --python-version "$python_tag" --implementation cp --abi "cp$(echo "$python_tag" | tr -d .)" \
        --platform "$wheel_platform" --dest "$1" "$package==$version" ||
        fail "pip could not download $package==$version for $wheel_platform (see above).
Behind a mirror, set PIP_INDEX_URL; behind a proxy, HTTPS_PROXY. Or get the library by other
means and set ORT_DYLIB_PATH to it."
    set -- "$1"/*.whl
    [ -f "$1" ] || fail "pip reported success but left no wheel."
    wheel=$1
}

# Hardened systems refuse to load a library that wants an executable stack (ELF: flag X of the segment
# PT_GNU_STACK, or no such segment). Other kinds of libraries have no such thing.
expect_no_executable_stack() {
    python3 - "$1" <<'PYTHON' || fail "$library wants an executable stack."
import struct
import sys

with open(sys.argv[1], "rb") as file:
    head = file.read(64)
    if head[:5] != b"\x7fELF\x02":
        sys.exit(0)
    offset, = struct.unpack_from("<Q", head, 32)
    size, count = struct.unpack_from("<HH", head, 54)
    file.seek(offset)
    segments = [file.read(size) for _ in range(count)]
GNU_STACK, EXECUTE = 0x6474E551, 1
flags = [struct.unpack_from("<II", segment)[1] for segment in segments
         if struct.unpack_from("<I", segment)[0] == GNU_STACK]
sys.exit(not flags or any(flag & EXECUTE for flag in flags))
PYTHON
}

install_library() {
    mkdir -p "$dest/lib" || fail "cannot write to $dest."
    # Staged inside the destination, so that each move is a rename within one file system.
    stage=$(mktemp -d "$dest/.fetch.XXXXXX") || fail "cannot write to $dest."
    trap 'rm -rf "$stage"' EXIT
    trap 'exit 130' INT TERM HUP
    download "$stage"
    expect_sha256 "$wheel" "$wheel_sha256" "the downloaded wheel"
    python3 -m zipfile -e "$wheel" "$stage/wheel" || fail "cannot unpack the wheel."
    expect_sha256 "$stage/wheel/$member" "$library_sha256" "the library in the wheel"
    expect_no_executable_stack "$stage/wheel/$member"
    chmod 0644 "$stage/wheel/$member" "$stage/wheel/onnxruntime/LICENSE" \
        "$stage/wheel/onnxruntime/ThirdPartyNotices.txt"
    mv -f "$stage/wheel/onnxruntime/LICENSE" "$dest/LICENSE"
    mv -f "$stage/wheel/onnxruntime/ThirdPartyNotices.txt" "$dest/ThirdPartyNotices.txt"
    [ -z "$cuda" ] || install_cuda
    mv -f "$stage/wheel/$member" "$dest/lib/$library"
}

# Puts the CUDA provider and NVIDIA's libraries beside where the library will be, and their licences
# into DIR/nvidia.
install_cuda() {
    nvidia_wheels >"$stage/nvidia.txt"
    python3 -m pip download --quiet --no-deps --only-binary=:all: --require-hashes \
        --platform manylinux_2_27_x86_64 --platform manylinux_2_17_x86_64 \
        --platform manylinux_2_12_x86_64 --dest "$stage/wheels" --requirement "$stage/nvidia.txt" ||
        fail "pip could not download NVIDIA's libraries (see above)."
    mkdir "$stage/nvidia"
    for wheel in "$stage/wheels"/*.whl; do
        python3 -m zipfile -e "$wheel" "$stage/cuda" || fail "cannot unpack $wheel."
        rm "$wheel"
    done
    for licence in "$stage/cuda"/*.dist-info/licenses/License.txt; do
        name=${licence#"$stage/cuda/"}
        mv "$licence" "$stage/nvidia/${name%%-*}.txt"
    done
    mv -f "$stage/wheel/onnxruntime/capi/libonnxruntime_providers_shared.so" \
        "$stage/wheel/onnxruntime/capi/libonnxruntime_providers_cuda.so" \
        "$stage"/cuda/nvidia/*/lib/lib*.so.* "$dest/lib/"
    # Of no use here.
    rm -f "$dest/lib"/libnvblas.so.* "$dest/lib"/libnvrtc*.alt.so.*
    chmod 0644 "$dest/lib"/lib* "$stage/nvidia"/*
    rm -rf "$dest/nvidia"
    mv "$stage/nvidia" "$dest/nvidia"
}

dest=
cuda=
while [ $# -gt 0 ]; do
    case "$1" in
    --dest)
        [ $# -ge 2 ] && [ -n "$2" ] || fail "--dest needs a folder."
        dest=$2
        shift 2
        ;;
    --dest=?*)
        dest=${1#--dest=}
        shift
        ;;
    --cuda)
        cuda=yes
        shift
        ;;
    -h | --help)
        usage
        exit 0
        ;;
    *) fail "unknown option '$1' (try --help)." ;;
    esac
done

platform=$(uname -s)-$(uname -m)
if [ -n "$cuda" ]; then
    select_cuda "$platform"
    [ -n "$dest" ] || dest=$(dirname "$0")/../.onnxruntime/cuda
else
    select_platform "$platform"
    [ -n "$dest" ] || dest=$(dirname "$0")/../.onnxruntime
fi
is_installed && exit 0
check_system "$platform"
check_python
echo "Downloading ONNX Runtime $version ($wheel_platform${cuda:+, with CUDA 13}) with pip .."
install_library
echo "ONNX Runtime $version is in $(cd "$dest" && pwd)/lib/$library"
