#!/usr/bin/env bash
# Installs what is missing and runs all tests. Arguments go to `cargo test`.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
launch_scripts/install_dependencies.sh
export PATH="${HOME:-/}/.cargo/bin:$PATH"
exec cargo test --release --locked --workspace "$@"
