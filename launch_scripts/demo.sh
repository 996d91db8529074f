#!/usr/bin/env bash
# Builds everything, replays a sequence through the ROS 2 nodes as separate processes, and reports how well the camera was
# tracked: demo.sh [SEQUENCE] [--out DIR] [--composed] [--rate R]
#   SEQUENCE    folder in TUM layout or its .tgz; default: the bundled one
#   --out DIR   folder for the results; default: out/demo-SEQUENCE
#   --composed  segmentation and tracking in one process (slam_node)
#   --rate R    speed of the replay; default 1; 0 waits for the nodes after each frame, so that a busy machine loses nothing
# ROS_DOMAIN_ID, where set, is used; otherwise the demo takes one of its own. Everything stays on the loopback interface.
set -euo pipefail
root=$(cd "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/.." && pwd)
source "$root/launch_scripts/processes.sh"

fail() {
    echo "demo.sh: $*" >&2
    exit 1
}

usage() {
    sed -n '2,9s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"
    exit "$1"
}

read_arguments() {
    local given=$root/tests/data/composite-demo speed=1 name
    out='' composed=0
    while [ $# -gt 0 ]; do
        case $1 in
            --out) out=${2:?--out needs a folder} && shift ;;
            --rate) speed=${2:?--rate needs a number} && shift ;;
            --composed) composed=1 ;;
            -h | --help) usage 0 ;;
            -*)
                echo "demo.sh: unknown option $1" >&2
                usage 2 >&2
                ;;
            *) given=$1 ;;
        esac
        shift
    done
    sequence=$(realpath -e "$given" 2>/dev/null) || fail "no such sequence: $given"
    rate=$(LC_ALL=C printf '%.3f' "$speed" 2>/dev/null) || fail "--rate needs a number, not '$speed'"
    name=$(basename "$sequence")
    out=$(realpath -m "${out:-$root/out/demo-${name%.tgz}}")
}

# Images over UDP need room in the kernel's receive buffer.
check_receive_buffer() {
    local needed=4194304 have limit=/proc/sys/net/core/rmem_max
    have=$(cat $limit 2>/dev/null) || return 0
    [ "$have" -ge $needed ] && return 0
    if [ -w $limit ] && (echo $needed >$limit) 2>/dev/null; then
        echo "net.core.rmem_max was $have bytes, too few for images: set to $needed until the next start."
    else
        echo "net.core.rmem_max is $have bytes: images will be lost. Run: sudo sysctl -w net.core.rmem_max=$needed" >&2
    fi
}

build() {
    export PATH="${HOME:-/}/.cargo/bin:$PATH"
    echo "Building (a few minutes the first time) ..."
    # All programs: a choice of packages would build common dependencies anew, with other features than tests and lints use.
    cargo build --release --locked --workspace --bins
    bin=${CARGO_TARGET_DIR:-$root/target}/release
}

start() { # NAME ARGUMENT...: starts a node with its log in the results
    local name=$1
    shift
    "$bin/$name" --ros-args --params-file config/replay.yaml "$@" >"$out/$name.log" 2>&1 &
    pids+=($!)
}

start_nodes() {
    if [ "$composed" = 1 ]; then
        start slam_node -p trajectory_file:="$out/trajectory.txt" -p frames_file:="$out/frames.csv" \
            -p mask_directory:="$out/masks"
    else
        # Without the clock's pressure a mask may take its time.
        local patience=()
        case $rate in 0.000) patience=(-p mask_timeout:=30.0) ;; esac
        start segmentation_node -p frames_file:="$out/segmentation.csv" -p mask_directory:="$out/masks"
        start tracking_node -p trajectory_file:="$out/trajectory.txt" -p frames_file:="$out/frames.csv" "${patience[@]}"
    fi
    nodes=("${pids[@]}")
    start bag_replay_node -p sequence:="$sequence" -p rate:="$rate" -p wait_for_subscribers:=${#nodes[@]}
    replay=${pids[-1]}
}

masks() { find "$out/masks" -name '*.png' 2>/dev/null | wc -l; }

# " of N" where the sequence is a folder.
of_all() {
    if [ -f "$sequence/rgb.txt" ]; then echo " of $(grep -cv '^#' "$sequence/rgb.txt")"; fi
}

show_progress() {
    if [ -t 1 ]; then printf '\r%s%s frames segmented ' "$(masks)" "$total"; fi
}

check_alive() {
    local pid
    for pid in "${nodes[@]}"; do
        kill -0 "$pid" 2>/dev/null || fail "a node ended early: $(tail -qn 1 "$out"/*_node.log)"
    done
}

# The replay has ended; what is still queued in the nodes is worked off.
wait_until_idle() {
    local before=-1 now
    now=$(masks)
    while [ "$before" != "$now" ]; do
        before=$now
        sleep 2
        now=$(masks)
        show_progress
    done
}

stop_nodes() {
    local pid
    for pid in "${nodes[@]}"; do kill -INT "$pid" 2>/dev/null || true; done
    for pid in "${nodes[@]}"; do
        wait "$pid" || fail "a node did not end well: $(tail -qn 1 "$out"/*_node.log)"
    done
    pids=()
}

read_arguments "$@"
stop_at_exit
cd "$root"
launch_scripts/install_dependencies.sh
check_receive_buffer
build
# What an earlier demo left, perhaps with other nodes, is not mixed in.
rm -rf "$out/masks" "$out"/{frames,segmentation}.csv "$out/trajectory.txt" "$out"/*_node.log "$out"/report.{json,html}
mkdir -p "$out"
export ROS_DOMAIN_ID=${ROS_DOMAIN_ID:-$((RANDOM % 90 + 10))} ROS_LOCALHOST_ONLY=1
start_nodes
total=$(of_all)
echo "Replaying $sequence at rate $rate (ROS_DOMAIN_ID $ROS_DOMAIN_ID) ..."
while kill -0 "$replay" 2>/dev/null; do
    show_progress
    check_alive
    sleep 0.5
done
wait "$replay" || fail "the replay failed: $(tail -n 1 "$out/bag_replay_node.log")"
wait_until_idle
if [ -t 1 ]; then echo; fi
stop_nodes
"$bin/pfd-slam" report "$sequence" "$out" --config config/replay.yaml | tee "$out/summary.txt"
if grep -q 'did not arrive' "$out/summary.txt"; then
    echo "Frames were lost because this machine was too busy for rate $rate: --rate 0 waits for the nodes after each frame."
fi
