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
    # Not grep -q, which may end before ldconfig has written everything, and that would count as a failure.
    [ -n "${LIBCLANG_PATH:-}" ] || PATH=$PATH:/sbin ldconfig -p | grep 'libclang[-.0-9]*\.so' ||
        compgen -G '/usr/lib/llvm-*/lib/libclang*.so*' >/dev/null
}

# The binding generator parses OpenCV's headers with libclang, which takes its built-in headers from beside clang.
need g++ command -v c++
need pkg-config command -v pkg-config
need libopencv-dev pkg-config --exists opencv4
need clang command -v clang
need libclang-dev has_libclang

# Rust of rustup goes before that of the distribution, which may be too old.
check_rust() {
    local needed found
    needed=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/../Cargo.toml")
    found=$(PATH="${HOME:-/}/.cargo/bin:$PATH" rustc --version 2>/dev/null | cut -d' ' -f2) || found=none
    if [ "$found" != none ] && printf '%s\n' "$needed" "$found" | sort -C -V; then return; fi
    cat >&2 <<TEXT
Rust $needed or newer is needed (found: $found). Install it with
    curl --proto '=https' --tlsv1.2 -sSf https://sh.rustup.rs | sh
(curl: apt-get install curl ca-certificates), or with \`rustup update\`.
TEXT
    exit 1
}
check_rust

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
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive $command
