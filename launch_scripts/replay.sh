#!/usr/bin/env bash
# Replays a sequence in TUM layout (folder or .tgz) through the nodes: replay.sh SEQUENCE [RATE] [ROS arguments for the SLAM nodes].
# RATE 1 is real time (default), 0 as fast as the nodes take it, without loss. PFD_SLAM_SEPARATE=1 starts segmentation and
# tracking as separate processes.
sequence=${1:?usage: replay.sh SEQUENCE [RATE] [ROS arguments]}
rate=${2:-1.0}
source "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/nodes.sh"
start_slam "$config/replay.yaml" "${@:3}"
start bag_replay_node --params-file "$config/replay.yaml" -p sequence:="$sequence" -p rate:="$rate" \
  -p wait_for_subscribers:=${#pids[@]}
wait "${pids[-1]}"
