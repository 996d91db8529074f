"""Reads the messages of pfd_slam_msgs on rclpy, calls a service of that package, and reports as JSON. The package comes from
ros_build_msgs.sh.

usage: ros_own_messages.py NODE TRAJECTORY_FILE
"""

import json
import os
import sys
import threading
import time

import rclpy
from pfd_slam_msgs.msg import DynamicRegions, TrackingState
from pfd_slam_msgs.srv import FilePath

WANTED = 20  # messages of each kind
TIMEOUT = 120.0  # seconds


def main():
    target, path = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("reader")
    states, regions = [], []
    node.create_subscription(TrackingState, "tracking_state", states.append, 10)
    node.create_subscription(DynamicRegions, "dynamic_regions", regions.append, 10)
    client = node.create_client(FilePath, f"/{target}/save_trajectory")
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    deadline = time.time() + TIMEOUT
    while min(len(states), len(regions)) < WANTED and time.time() < deadline:
        time.sleep(0.1)
    client.wait_for_service(TIMEOUT)
    done = threading.Event()
    future = client.call_async(FilePath.Request(path=path))
    future.add_done_callback(lambda _: done.set())
    done.wait(TIMEOUT)
    last = states[-1] if states else TrackingState()
    print(json.dumps({
        "states": len(states), "regions": len(regions), "state": last.state, "ok": TrackingState.OK, "features": last.features,
        "stages": [stage.name for stage in last.stages], "mask_used": last.mask_used,
        "objects": sum(len(message.regions) for message in regions),
        "boxes_fit": all(r.bounding_box.x_offset + r.bounding_box.width <= 640 for m in regions for r in m.regions),
        "saved": [future.result().success, future.result().message] if future.done() else None,
    }), flush=True)
    # The spinning thread must not outlive the context.
    os._exit(0)


main()
