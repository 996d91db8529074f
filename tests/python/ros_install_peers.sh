#!/usr/bin/env bash
# Installs the peers of the interoperability tests from PyPI: rclpy (ROS 2 Jazzy, needs Python 3.12) and Cyclone DDS (any Python 3),
# below $PFD_PEERS, else below target/peers. PYTHON312 names a Python 3.12 that is not in the PATH.
set -euo pipefail
root=${PFD_PEERS:-$(cd "$(dirname "$0")/../.." && pwd)/target/peers}
mkdir -p "$root"
# A Python 3.12 that runs: pyenv's shims may stand for one that is not chosen.
find_python312() {
  local candidate
  for candidate in "${PYTHON312:-}" python3.12 "$HOME"/.pyenv/versions/3.12.*/bin/python; do
    if [ -n "$candidate" ] && "$candidate" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; then
      echo "$candidate"
      return
    fi
  done
}
python312=$(find_python312)
if [ -n "$python312" ]; then
  [ -x "$root/jazzy/bin/python" ] || "$python312" -m venv "$root/jazzy"
  "$root/jazzy/bin/pip" install --quiet ros-jazzy-rclpy ros-jazzy-rmw-fastrtps-cpp ros-jazzy-sensor-msgs ros-jazzy-nav-msgs \
    ros-jazzy-geometry-msgs ros-jazzy-visualization-msgs ros-jazzy-diagnostic-msgs ros-jazzy-std-srvs ros-jazzy-rosgraph-msgs numpy pillow
  echo "rclpy: $root/jazzy"
else
  echo "rclpy is skipped: no Python 3.12 (set PYTHON312)" >&2
fi
[ -x "$root/cyclone/bin/python" ] || python3 -m venv "$root/cyclone"
"$root/cyclone/bin/pip" install --quiet cyclonedds numpy
echo "Cyclone DDS: $root/cyclone"
