"""A camera on rclpy of which depth first has the clock of another computer, and whose images later halve in size. Prints as JSON what
the node says of the first, and where the odometry is before and after the second.

usage: ros_odd_camera.py SEQUENCE
"""

import array
import copy
import json
import os
import pathlib
import sys
import threading
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from ros_camera import RATE, Camera, Frames

LAG = 5  # seconds by which depth is behind
SKEWED, WHOLE, HALVED = 5.0, 2.5, 3.0  # seconds of each part
PAUSE = 1.0  # seconds in which what was sent is worked on


def play(camera, first, seconds):
    begun = time.monotonic()
    for i in range(int(seconds * RATE)):
        time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
        camera.publish(first + i)
    time.sleep(PAUSE)


def halved(frames):
    """The same at half the resolution: every second pixel of every second row."""

    def image(whole, channels, kind):
        pixels = np.frombuffer(whole.data, kind).reshape(whole.height, whole.width, channels)[::2, ::2]
        height, width = pixels.shape[:2]
        data = array.array("B", np.ascontiguousarray(pixels).tobytes())
        return type(whole)(height=height, width=width, encoding=whole.encoding, step=len(data) // height, data=data)

    small, info = copy.copy(frames), frames.info
    small.pairs = [(image(rgb, 3, np.uint8), image(depth, 1, np.uint16)) for rgb, depth in frames.pairs]
    small.info = type(info)(height=info.height // 2, width=info.width // 2, distortion_model=info.distortion_model, d=info.d,
                            k=[value / 2 for value in info.k[:8]] + [1.0])
    return small


def main():
    frames = Frames(pathlib.Path(sys.argv[1]))
    small = halved(frames)
    rclpy.init()
    node = rclpy.create_node("camera")
    said, places = [], []
    listen = lambda m: said.extend(s.message for s in m.status if s.name.endswith("camera"))
    node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
    node.create_subscription(Odometry, "odometry", lambda m: places.append(m.pose.pose.position), 100)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    camera = Camera(node, frames, "best_effort")
    camera.depth_lag = LAG
    time.sleep(PAUSE)
    play(camera, 0, SKEWED)
    differences = [message for message in said if "stamps differ" in message]
    report = {"skewed": differences[-1] if differences else said[-1:], "poses_while_skewed": len(places)}
    camera.depth_lag = 0
    play(camera, 0, WHOLE)
    before, camera.frames = len(places), small
    play(camera, int(WHOLE * RATE), HALVED)
    position = lambda place: [place.x, place.y, place.z]
    report["before"] = position(places[before - 1]) if before else None
    report["after"] = position(places[before]) if len(places) > before else None
    report["poses_after"] = len(places) - before
    print(json.dumps(report), flush=True)
    # The spinning thread must not outlive the context.
    os._exit(0)


main()
