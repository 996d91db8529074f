#!/usr/bin/env bash
# Installs what the build needs and the machine lacks: OpenCV with headers, libclang, a C++ compiler, pkg-config.
# As root or with sudo it installs Debian or Ubuntu packages and says which; otherwise it prints the command and exits with 1.
set -euo pipefail

missing=()
need() { # PACKAGE COMMAND...: the package is missing if the command fails
    local package=$1
    shift
    "$@" >/dev/null 2>&1 || missing+=("$package")
}

has_libclang() {
    [ -n "${LIBCLANG_PATH:-}" ] || PATH=$PATH:/sbin ldconfig -p | grep -q 'libclang[-.0-9]*\.so' ||
        compgen -G '/usr/lib/llvm-*/lib/libclang*.so*' >/dev/null
}

# The binding generator parses OpenCV's headers with libclang, which takes its built-in headers from beside clang.
need g++ command -v c++
need pkg-config command -v pkg-config
need libopencv-dev pkg-config --exists opencv4
need clang command -v clang
need libclang-dev has_libclang

rust_is_missing() {
    cat >&2 <<'TEXT'
Rust is missing (1.89 or newer). Install it with
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh
and open a new shell.
TEXT
    exit 1
}
[ -x "${HOME:-/}/.cargo/bin/cargo" ] || command -v cargo >/dev/null || rust_is_missing

[ ${#missing[@]} -eq 0 ] && exit 0

command="apt-get install -y --no-install-recommends ${missing[*]}"
if ! command -v apt-get >/dev/null; then
    echo "Missing: ${missing[*]} (names of Debian packages). Install your system's equivalents." >&2
    exit 1
fi
if [ "$(id -u)" -eq 0 ]; then
    as_root=()
elif command -v sudo >/dev/null && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
    as_root=(sudo)
else
    echo "Missing: ${missing[*]}. Root is needed to install them:" >&2
    echo "    sudo apt-get update && sudo $command" >&2
    exit 1
fi
echo "Installing: ${missing[*]}"
"${as_root[@]}" apt-get update -qq
# shellcheck disable=SC2086  # the command is a list of words
DEBIAN_FRONTEND=noninteractive "${as_root[@]}" $command
