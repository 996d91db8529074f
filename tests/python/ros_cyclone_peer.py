"""A camera and an observer on Cyclone DDS: publishes a moving textured wall and its camera's place on /tf_static, and reports, as
JSON, the transforms, poses and masks that the nodes publish.

usage: ros_cyclone_peer.py SECONDS
"""

import json
import os
import sys
import time

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros_cyclone_types import (
    LOOPBACK, CameraInfo, Header, Image, PoseStamped, Quaternion, RegionOfInterest, TFMessage, Time, Transform, TransformStamped,
    Vector3,
)

WIDTH, HEIGHT, FOCAL, DEPTH, PIXELS_PER_FRAME = 640, 480, 525.0, 2.0, 4


def now():
    return Time(*divmod(time.time_ns(), 1_000_000_000))


def main():
    number = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    domain = Domain(number, LOOPBACK)
    participant = DomainParticipant(number)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    latched = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(1), Policy.Durability.TransientLocal)
    sensor = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
    topic = lambda name, kind: Topic(participant, f"rt/{name}", kind)
    rgb = DataWriter(participant, topic("rgb/image", Image), sensor)
    depth = DataWriter(participant, topic("depth/image", Image), sensor)
    info = DataWriter(participant, topic("rgb/camera_info", CameraInfo), sensor)
    static = DataWriter(participant, topic("tf_static", TFMessage), latched)
    tf = DataReader(participant, topic("tf", TFMessage), reliable)
    poses = DataReader(participant, topic("pose", PoseStamped), reliable)
    masks = DataReader(participant, topic("dynamic_mask", Image), reliable)

    blocks = np.random.default_rng(7).integers(0, 256, (HEIGHT // 8, 4 * WIDTH // 8, 3), dtype=np.uint8)
    wall = np.repeat(np.repeat(blocks, 8, 0), 8, 1)
    depth_data = list(np.full((HEIGHT, WIDTH), 1000 * DEPTH, np.uint16).tobytes())
    upright = Quaternion(-0.5, 0.5, -0.5, 0.5)
    place = Transform(Vector3(0.0, 0.0, 0.0), upright)
    static.write(TFMessage([TransformStamped(Header(now(), "camera_link"), "camera_optical", place)]))

    transforms, count, mask, frame = {}, 0, None, 0
    deadline = time.time() + float(sys.argv[1])
    while time.time() < deadline:
        shift = PIXELS_PER_FRAME * frame % (3 * WIDTH)
        header = Header(now(), "camera_optical")
        k = [FOCAL, 0.0, WIDTH / 2, 0.0, FOCAL, HEIGHT / 2, 0.0, 0.0, 1.0]
        info.write(CameraInfo(header, HEIGHT, WIDTH, "plumb_bob", [0.0] * 5, k, [0.0] * 9, [0.0] * 12, 0, 0,
                              RegionOfInterest(0, 0, 0, 0, False)))
        view = np.ascontiguousarray(wall[:, shift:shift + WIDTH])
        rgb.write(Image(header, HEIGHT, WIDTH, "rgb8", 0, 3 * WIDTH, list(view.tobytes())))
        depth.write(Image(header, HEIGHT, WIDTH, "16UC1", 0, 2 * WIDTH, depth_data))
        frame += 1
        for message in tf.take(N=100):
            for t in message.transforms:
                key = f"{t.header.frame_id}->{t.child_frame_id}"
                transforms[key] = transforms.get(key, 0) + 1
        count += len(poses.take(N=100))
        for message in masks.take(N=10):
            mask = [message.width, message.height, message.encoding, len(message.data)]
    print(json.dumps({"frames": frame, "transforms": transforms, "poses": count, "mask": mask}))
    del domain


main()
