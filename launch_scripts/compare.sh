#!/usr/bin/env bash
# PFD-SLAM and ORB-SLAM3 on the same frames, one after the other on this machine: compare.sh SEQUENCE...
# Prints ATE (RMSE, m), share of frames tracked, and time per frame. ORB-SLAM3 (PyPI: pyorbslam3, GPL) runs as a program of its
# own, from a Python environment that is made in out/orbslam3 on first use; PFD_PYTHON names a Python that has it already.
# Its vocabulary is downloaded; where that fails, one is trained on the given sequences. PYORBSLAM3_VOCAB names ORBvoc.txt.
# Where it cannot run, it is skipped with a reason.
set -euo pipefail
[ $# -gt 0 ] || { sed -n '2,6s/^# //p' "${BASH_SOURCE[0]}" >&2; exit 2; }
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
environment=$root/out/orbslam3
bin=${CARGO_TARGET_DIR:-$root/target}/release
export PATH="${HOME:-/}/.cargo/bin:$PATH"
for sequence in "$@"; do
    [ -f "$sequence/rgb.txt" ] || { echo "compare.sh: no folder in TUM layout: $sequence" >&2; exit 2; }
done
command -v python3 >/dev/null || { echo "compare.sh: python3 is missing: apt-get install python3 python3-venv" >&2; exit 1; }
(cd "$root" && cargo build --quiet --release --locked --workspace --bins)
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

row() { printf '%-32s %-18s %10s %9s %10s %10s\n' "$@"; }

# field FILE EXPRESSION: a number of a JSON file
field() { python3 -c 'import json,sys; d=json.load(open(sys.argv[1])); print(f"{eval(sys.argv[2]):.4f}")' "$@"; }

can_run() { "$1" -c 'import pyorbslam3, cv2' 2>/dev/null; }

# Sets $python to one that can run ORB-SLAM3, made where there is none.
find_python() {
    local candidate
    for candidate in ${PFD_PYTHON:+"$PFD_PYTHON"} "$environment/bin/python" python3; do
        if can_run "$candidate"; then
            python=$candidate
            return
        fi
    done
    for candidate in python3 python3.11 python3.12 python3.13; do
        command -v "$candidate" >/dev/null || continue
        "$candidate" -m venv --clear "$environment" >"$out/pip.log" 2>&1 || continue
        echo "Installing pyorbslam3 for $("$candidate" --version) in $environment ..." >&2
        "$environment/bin/pip" install --quiet pyorbslam3 opencv-python-headless >"$out/pip.log" 2>&1 || continue
        if can_run "$environment/bin/python"; then
            python=$environment/bin/python
            return
        fi
    done
    echo "ORB-SLAM3 skipped: pyorbslam3 cannot be installed (venv is in package python3-venv): $(tail -n 1 "$out/pip.log")" >&2
    return 1
}

# Sets PYORBSLAM3_VOCAB: given, downloaded, or trained here.
find_vocabulary() {
    local download='import socket, pyorbslam3; socket.setdefaulttimeout(20); print(pyorbslam3.vocabulary_path(quiet=True))'
    [ -z "${PYORBSLAM3_VOCAB:-}" ] || return 0
    if ! PYORBSLAM3_VOCAB=$("$python" -c "$download" 2>/dev/null); then
        echo "ORB-SLAM3's vocabulary cannot be downloaded; training one on these sequences (a minute) ..." >&2
        PYORBSLAM3_VOCAB=$out/vocabulary.txt
        if ! "$python" "$root/tests/python/orb_vocabulary.py" "$PYORBSLAM3_VOCAB" "$@" 2>"$out/vocabulary.err"; then
            echo "ORB-SLAM3 skipped: no vocabulary: $(tail -n 1 "$out/vocabulary.err")" >&2
            return 1
        fi
    fi
    export PYORBSLAM3_VOCAB
}

ours() { # SEQUENCE NAME MODE
    local report=$out/$3/report.json
    "$bin/pfd-slam" run "$1" --out "$out/$3" --mode "$3" >/dev/null 2>"$out/log" || { cat "$out/log" >&2; exit 1; }
    row "$2" "PFD-SLAM ($3)" "$(field "$report" 'd["ate"]["rmse"] if d["ate"] else float("nan")')" \
        "$(field "$report" 'd["tracked"]')" "$(field "$report" 'd["timing_ms"]["total"]["median"]')" \
        "$(field "$report" 'd["timing_ms"]["total"]["p99"]')"
}

theirs() { # SEQUENCE NAME
    if ! "$python" "$root/tests/python/orbslam3.py" "$1" "$out/orb.txt" >"$out/orb.log" 2>"$out/orb.err"; then
        tail -n 1 "$out/orb.err" >&2
        return
    fi
    tail -n 1 "$out/orb.log" >"$out/orb.json"
    local ate=–
    if "$bin/pfd-slam" eval "$1/groundtruth.txt" "$out/orb.txt" --json >"$out/orb-errors.json" 2>/dev/null; then
        ate=$(field "$out/orb-errors.json" 'd["ate"]["rmse"]')
    fi
    row "$2" ORB-SLAM3 "$ate" "$(field "$out/orb.json" 'd["tracked"]')" "$(field "$out/orb.json" 'd["median_ms"]')" \
        "$(field "$out/orb.json" 'd["p99_ms"]')"
}

python='' has_orb=0
if find_python && find_vocabulary "$@"; then has_orb=1; fi
row sequence system 'ATE (m)' tracked 'median ms' 'p99 ms'
for sequence in "$@"; do
    name=$(basename "$sequence")
    for mode in pfd none; do ours "$sequence" "$name" "$mode"; done
    if [ $has_orb = 1 ]; then theirs "$sequence" "$name"; fi
done
