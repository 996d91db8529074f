# Sourced by replay.sh, realsense.sh and xtion.sh: finds the binaries and starts nodes, which end with the script.
# shellcheck shell=bash
set -euo pipefail
here=$(cd "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/.." && pwd)
config=$here/config
bin=${PFD_SLAM_BIN:-${CARGO_TARGET_DIR:-$here/target}/release}
if [ ! -x "$bin/slam_node" ]; then
  echo "no binaries in $bin: run \`cargo build --release --workspace --bins\` first, or set PFD_SLAM_BIN" >&2
  exit 1
fi
source "$here/launch_scripts/processes.sh"
stop_at_exit
start() {
  "$bin/$1" --ros-args "${@:2}" &
  pids+=($!)
}
# start_slam CONFIG [ROS arguments]: one composed process, or with PFD_SLAM_SEPARATE=1 segmentation and tracking apart.
start_slam() {
  if [ "${PFD_SLAM_SEPARATE:-0}" = 1 ]; then
    start segmentation_node --params-file "$1" "${@:2}"
    start tracking_node --params-file "$1" "${@:2}"
  else
    start slam_node --params-file "$1" "${@:2}"
  fi
}
