#!/usr/bin/env bash
# Measures the figures that stand in the README and puts them there, with the commit that they belong to: results.sh [SEEDS] [FOLDER]
#   SEEDS   runs per sequence and mode; default: 3
#   FOLDER  has the sequences; default: $PFD_DATA, else ../shared/data beside the repository. Those that are not there are left out.
# About three minutes per seed on an idle machine with two cores. Goes on where it was interrupted; out/results has all tables.
set -euo pipefail
root=$(cd "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/.." && pwd)
case ${1:-} in -*) sed -n '2,5s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"; exit 2 ;; esac
seeds=${1:-3}
data=$(realpath -m "${2:-${PFD_DATA:-$root/../shared/data}}")
cd "$root"
export PATH="${HOME:-/}/.cargo/bin:$PATH"
cargo build --release --locked --workspace --bins
bin=${CARGO_TARGET_DIR:-target}/release

# Results of other commits are not mixed in.
commit=$(git rev-parse --short HEAD)
git diff --quiet HEAD -- crates Cargo.lock || commit+=" with changes"
out=out/results/${commit// /-}
sequences=(tests/data/composite-demo)
for name in tum-fr1-xyz-first180 composite-walking synthetic-dev-{walking-xyz,walking-half,sitting-xyz}; do
    if [ -d "$data/$name" ]; then sequences+=("$data/$name"); else echo "left out: $data/$name is not there" >&2; fi
done
"$bin/pfd-slam" bench "${sequences[@]}" --modes pfd,none,given --runs "$seeds" --out "$out" --into README.md \
    --about "commit $commit on $(nproc) cores"
