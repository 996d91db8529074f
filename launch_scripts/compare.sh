#!/usr/bin/env bash
# PFD-SLAM and ORB-SLAM3 on the same frames, one after the other on this machine: compare.sh SEQUENCE...
# Prints ATE (RMSE, m), share of frames tracked, and time per frame. ORB-SLAM3 (pip install pyorbslam3) runs as a program of its
# own, and is skipped with a reason where it cannot run. PFD_PYTHON names another Python.
set -euo pipefail
[ $# -gt 0 ] || { sed -n '2,4s/^# //p' "${BASH_SOURCE[0]}" >&2; exit 2; }
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
python=${PFD_PYTHON:-python3}
bin=${CARGO_TARGET_DIR:-$root/target}/release
(cd "$root" && cargo build --quiet --release --locked -p pfd-slam)
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

row() { printf '%-32s %-18s %10s %9s %10s %10s\n' "$@"; }

# field FILE EXPRESSION: a number of a JSON file
field() { "$python" -c 'import json,sys; d=json.load(open(sys.argv[1])); print(f"{eval(sys.argv[2]):.4f}")' "$@"; }

row sequence system 'ATE (m)' tracked 'median ms' 'p99 ms'
for sequence in "$@"; do
    name=$(basename "$sequence")
    for mode in pfd none; do
        "$bin/pfd-slam" run "$sequence" --out "$out/$mode" --mode "$mode" >/dev/null 2>"$out/log" || { cat "$out/log" >&2; exit 1; }
        report=$out/$mode/report.json
        row "$name" "PFD-SLAM ($mode)" "$(field "$report" 'd["ate"]["rmse"] if d["ate"] else float("nan")')" \
            "$(field "$report" 'd["tracked"]')" "$(field "$report" 'd["timing_ms"]["total"]["median"]')" \
            "$(field "$report" 'd["timing_ms"]["total"]["p99"]')"
    done
    if "$python" "$root/tests/python/orbslam3.py" "$sequence" "$out/orb.txt" >"$out/orb.log" 2>"$out/orb.err"; then
        tail -n 1 "$out/orb.log" >"$out/orb.json"
        "$bin/pfd-slam" eval "$sequence/groundtruth.txt" "$out/orb.txt" --json >"$out/orb-errors.json"
        row "$name" ORB-SLAM3 "$(field "$out/orb-errors.json" 'd["ate"]["rmse"]')" "$(field "$out/orb.json" 'd["tracked"]')" \
            "$(field "$out/orb.json" 'd["median_ms"]')" "$(field "$out/orb.json" 'd["p99_ms"]')"
    else
        tail -n 1 "$out/orb.err" >&2
    fi
done
