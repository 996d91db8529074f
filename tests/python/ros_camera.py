"""A 30 Hz RGB-D camera on rclpy that plays a sequence forwards and backwards with present stamps.

usage: ros_camera.py SEQUENCE [RELIABILITY]; prints the stamp of its first frame and goes on until it is killed
"""

import array
import json
import os
import pathlib
import random
import sys
import time

import tum

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
RATE = 30.0
TUM_DEPTH_TO_MM = 5.0


def prepare_environment():
    """Must come before rclpy is loaded."""
    profile = str(REPOSITORY / "tests/python/ros_fastdds.xml")
    os.environ.update(ROS_DISTRO="jazzy", RMW_IMPLEMENTATION="rmw_fastrtps_cpp",
                      FASTDDS_DEFAULT_PROFILES_FILE=profile, FASTRTPS_DEFAULT_PROFILES_FILE=profile)
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(20, 100)))


class Frames:
    """Messages made beforehand: the camera is to cost little."""

    def __init__(self, sequence):
        import numpy as np
        from PIL import Image as Picture
        from sensor_msgs.msg import CameraInfo, Image

        def message(path, encoding):
            pixels = np.asarray(Picture.open(path))
            if encoding == "16UC1":
                pixels = (pixels / TUM_DEPTH_TO_MM).round().astype(np.uint16)
            height, width = pixels.shape[:2]
            data = array.array("B", np.ascontiguousarray(pixels).tobytes())
            return Image(height=height, width=width, encoding=encoding, step=len(data) // height, data=data)

        def listed(name):
            lines = [line.split() for line in (sequence / name).read_text().splitlines() if line and line[0] != "#"]
            return [(float(stamp), sequence / file) for stamp, file, *_ in lines]

        depth = listed("depth.txt")
        nearest = lambda stamp: min(depth, key=lambda d: abs(d[0] - stamp))[1]
        self.pairs = [(message(rgb, "rgb8"), message(nearest(stamp), "16UC1")) for stamp, rgb in listed("rgb.txt")]
        calibration = tum.calibration(sequence)
        fx, fy, cx, cy = (float(calibration[k]) for k in ("fx", "fy", "cx", "cy"))
        rgb = self.pairs[0][0]
        self.info = CameraInfo(height=rgb.height, width=rgb.width, distortion_model="plumb_bob", d=json.loads(calibration["distortion"]),
                               k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0])

    def __getitem__(self, i):
        """Forwards, then backwards."""
        last = len(self.pairs) - 1
        i %= 2 * last
        return self.pairs[i if i <= last else 2 * last - i]


class Camera:
    depth_lag = 0  # seconds by which the stamps of depth are behind

    def __init__(self, node, frames, reliability):
        from builtin_interfaces.msg import Time
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CameraInfo, Image

        self.time = Time
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy[reliability.upper()])
        self.node, self.frames = node, frames
        self.publishers = [node.create_publisher(kind, topic, qos)
                           for kind, topic in ((CameraInfo, "rgb/camera_info"), (Image, "rgb/image"), (Image, "depth/image"))]

    def publish(self, i):
        """Publishes frame `i` and returns its stamp."""
        stamp = self.node.get_clock().now().to_msg()
        behind = self.time(sec=stamp.sec - self.depth_lag, nanosec=stamp.nanosec)
        for publisher, message, own in zip(self.publishers, (self.frames.info, *self.frames[i]), (stamp, stamp, behind)):
            message.header.stamp = own
            message.header.frame_id = "camera_optical"
            publisher.publish(message)
        return stamp.sec, stamp.nanosec


def main():
    prepare_environment()
    import rclpy

    frames = Frames(pathlib.Path(sys.argv[1]))
    rclpy.init()
    camera = Camera(rclpy.create_node("camera"), frames, sys.argv[2] if len(sys.argv) > 2 else "best_effort")
    begun, i = time.monotonic(), 0
    while True:
        time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
        stamp = camera.publish(i)
        if i == 0:
            print(*stamp, flush=True)
        i += 1


if __name__ == "__main__":
    main()
