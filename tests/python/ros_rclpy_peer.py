"""A camera and an observer on rclpy (Fast DDS): publishes a moving textured wall and reports, as JSON, what the nodes answer.

usage: ros_rclpy_peer.py NODE RELIABILITY SECONDS
"""

import array
import json
import os
import sys
import threading
import time

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

WIDTH, HEIGHT, FOCAL, DEPTH, RATE = 640, 480, 525.0, 2.0, 30.0
PIXELS_PER_FRAME = 2


class Peer:
    def __init__(self, target, reliability):
        self.target = target
        self.node = rclpy.create_node("camera")
        self.received = {}
        self.last = {}
        self.latency = []
        self.answers = {}
        self.frame = 0
        sensor = QoSProfile(depth=5, reliability=getattr(ReliabilityPolicy, reliability))
        self.rgb = self.node.create_publisher(Image, "rgb/image", sensor)
        self.depth = self.node.create_publisher(Image, "depth/image", sensor)
        self.info = self.node.create_publisher(CameraInfo, "rgb/camera_info", sensor)
        self.clock = self.node.create_publisher(Clock, "/clock", 10)
        self.subscribe()
        rng = np.random.default_rng(7)
        blocks = rng.integers(0, 256, (HEIGHT // 8, 4 * WIDTH // 8, 3), dtype=np.uint8)
        self.wall = np.repeat(np.repeat(blocks, 8, 0), 8, 1)
        self.depth_data = array.array("B", np.full((HEIGHT, WIDTH), 1000 * DEPTH, np.uint16).tobytes())

    def subscribe(self):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        for name, kind, qos in [
            ("dynamic_mask", Image, 5), ("overlay", Image, best_effort), ("pose", PoseStamped, 10),
            ("odometry", Odometry, 10), ("path", Path, latched), ("map_points", PointCloud2, latched),
            ("keyframes", MarkerArray, latched), ("/diagnostics", DiagnosticArray, 10), ("/rosout", Log, QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)),
        ]:
            self.node.create_subscription(kind, name, lambda m, name=name: self.receive(name, m), qos)

    def receive(self, name, message):
        self.received[name] = self.received.get(name, 0) + 1
        self.last[name] = message
        if name == "pose":
            stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
            self.latency.append(time.time() - stamp)

    def publish(self):
        stamp = self.node.get_clock().now().to_msg()
        shift = PIXELS_PER_FRAME * self.frame % (3 * WIDTH)
        rgb = Image(height=HEIGHT, width=WIDTH, encoding="bgr8", step=3 * WIDTH)
        # An array is taken as it is; of bytes rclpy would look at every one.
        rgb.data = array.array("B", np.ascontiguousarray(self.wall[:, shift:shift + WIDTH]).tobytes())
        depth = Image(height=HEIGHT, width=WIDTH, encoding="16UC1", step=2 * WIDTH)
        depth.data = self.depth_data
        info = CameraInfo(height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", d=[0.0] * 5)
        info.k = [FOCAL, 0.0, WIDTH / 2, 0.0, FOCAL, HEIGHT / 2, 0.0, 0.0, 1.0]
        for message, publisher in ((info, self.info), (rgb, self.rgb), (depth, self.depth)):
            message.header.stamp = stamp
            message.header.frame_id = "camera_optical"
            publisher.publish(message)
        self.frame += 1

    def call(self, kind, name, request, timeout=10.0):
        client = self.node.create_client(kind, f"/{self.target}/{name}")
        if not client.wait_for_service(timeout):
            return None
        done = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: done.set())
        return future.result() if done.wait(timeout) else None

    def trigger(self, name):
        response = self.call(Trigger, name, Trigger.Request())
        return response is not None and response.success

    def set(self, name, **value):
        parameter = Parameter(name=name, value=ParameterValue(**value))
        response = self.call(SetParameters, "set_parameters", SetParameters.Request(parameters=[parameter]))
        return None if response is None else [response.results[0].successful, response.results[0].reason]

    def talk(self):
        """Parameters, services, simulated time."""
        a = self.answers
        listed = self.call(ListParameters, "list_parameters", ListParameters.Request())
        everything = list(listed.result.names) if listed else []
        a["listed"] = everything
        # Answers of many datagrams' size.
        values = self.call(GetParameters, "get_parameters", GetParameters.Request(names=everything))
        a["all_values"] = [v.type for v in values.values] if values else None
        texts = self.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=everything))
        a["all_texts"] = [len(d.description) for d in texts.descriptors] if texts else None
        names = ["mask_timeout", "qos", "segmentation.particles.count"]
        got = self.call(GetParameters, "get_parameters", GetParameters.Request(names=names))
        a["got"] = [got.values[0].double_value, got.values[1].string_value, got.values[2].integer_value] if got else None
        described = self.call(DescribeParameters, "describe_parameters", DescribeParameters.Request(names=names))
        a["described"] = [[d.description, d.read_only, len(d.floating_point_range)] for d in described.descriptors] if described else None
        double, boolean, integer = ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_BOOL, ParameterType.PARAMETER_INTEGER
        a["set_good"] = self.set("mask_timeout", type=double, double_value=0.3)
        a["set_running"] = self.set("segmentation.particles.count", type=integer, integer_value=700)
        a["set_bad"] = self.set("mask_timeout", type=double, double_value=-1.0)
        a["pause"] = self.trigger("pause")
        a["resume"] = self.trigger("resume")
        a["sim_time"] = self.set("use_sim_time", type=boolean, bool_value=True)
        for _ in range(30):
            message = Clock()
            message.clock.sec = 1234
            self.clock.publish(message)
            time.sleep(0.1)
        diagnostics = self.last.get("/diagnostics")
        a["sim_stamp"] = diagnostics.header.stamp.sec if diagnostics else None
        self.set("use_sim_time", type=boolean, bool_value=False)

    def summary(self):
        graph = self.node.get_publisher_names_and_types_by_node(self.target, "/")
        odometry = self.last.get("odometry")
        latency = sorted(self.latency) or [float("nan")]
        return {
            "sent": self.frame,
            "received": self.received,
            "latency_ms": [round(1e3 * latency[int(q * (len(latency) - 1))], 1) for q in (0.5, 0.99)],
            "nodes": [name for name, _ in self.node.get_node_names_and_namespaces()],
            "topics": {name: types[0] for name, types in graph},
            "expected_x": self.frame * PIXELS_PER_FRAME * DEPTH / FOCAL,
            "position": [odometry.pose.pose.position.x, odometry.pose.pose.position.y, odometry.pose.pose.position.z] if odometry else None,
            "cloud": self.last["map_points"].width if "map_points" in self.last else 0,
            "diagnostics": [[s.name, int.from_bytes(s.level, "little"), s.message] for s in self.last["/diagnostics"].status] if "/diagnostics" in self.last else [],
            **self.answers,
        }


def main():
    target, reliability, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
    rclpy.init()
    peer = Peer(target, reliability)
    spinner = threading.Thread(target=rclpy.spin, args=(peer.node,), daemon=True)
    spinner.start()
    talker = threading.Thread(target=peer.talk)
    start, deadline = time.time() + 2.0, time.time() + 2.0 + seconds
    while time.time() < deadline:
        time.sleep(max(0.0, start + peer.frame / RATE - time.time()))
        peer.publish()
        if peer.frame == int(2 * RATE):
            talker.start()
    talker.join()
    time.sleep(1.0)
    print(json.dumps(peer.summary()), flush=True)
    # The spinning thread must not outlive the context.
    os._exit(0)


main()
