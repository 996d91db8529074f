"""Measures how long the nodes take to go on after a fault, beside a live rclpy camera (ros_camera.py).

usage: ros_recovery.py BIN_DIR; prints one line a fault
"""

import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

from ros_camera import REPOSITORY, prepare_environment

SUSPENDED = 3.0  # seconds
STEADY = 60  # results after which a fault is due
TIMEOUT = 60.0  # seconds
HERE = pathlib.Path(__file__).resolve().parent


class Observer:
    """Stamps and arrival times of masks and poses, in seconds of the system's clock."""

    def __init__(self):
        import rclpy
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import Image

        rclpy.init()
        self.node = rclpy.create_node("observer")
        self.seen = {"mask": [], "pose": []}
        self.node.create_subscription(Image, "dynamic_mask", lambda m: self.arrived("mask", m), 10)
        self.node.create_subscription(PoseStamped, "pose", lambda m: self.arrived("pose", m), 10)
        threading.Thread(target=rclpy.spin, args=(self.node,), daemon=True).start()

    def arrived(self, what, message):
        self.seen[what].append((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, time.time()))

    def wait(self, what, condition):
        deadline = time.time() + TIMEOUT
        while time.time() < deadline:
            found = next((arrival for stamp, arrival in self.seen[what] if condition(stamp)), None)
            if found is not None:
                return found
            time.sleep(0.005)
        return None

    def wait_until_steady(self):
        for what in self.seen:
            self.seen[what].clear()
        deadline = time.time() + TIMEOUT
        while min(map(len, self.seen.values())) < STEADY and time.time() < deadline:
            time.sleep(0.02)


class Trial:
    def __init__(self, binaries, names):
        self.binaries, self.names, self.observer = binaries, names, Observer()
        self.nodes = {name: self.start(name) for name in names}
        self.camera = self.start_camera()

    def start(self, name):
        return subprocess.Popen([self.binaries / name, "--ros-args", "--log-level", "error"])

    def start_camera(self):
        command = [sys.executable, HERE / "ros_camera.py", REPOSITORY / "tests/data/composite-demo"]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def report(self, fault, what, since):
        arrival = self.observer.wait(what, lambda stamp: stamp > since)
        print(f"{fault}: {what} after {arrival - since:.2f} s" if arrival else f"{fault}: NO {what} within {TIMEOUT} s", flush=True)

    def suspend(self, name, what):
        self.observer.wait_until_steady()
        self.nodes[name].send_signal(signal.SIGSTOP)
        time.sleep(SUSPENDED)
        self.nodes[name].send_signal(signal.SIGCONT)
        self.report(f"{name} suspended for {SUSPENDED:.0f} s and resumed", what, time.time())

    def replace(self, name, what):
        self.observer.wait_until_steady()
        self.nodes[name].kill()
        self.nodes[name].wait()
        self.nodes[name] = self.start(name)
        self.report(f"{name} killed and restarted", what, time.time())

    def replace_camera(self):
        self.observer.wait_until_steady()
        self.camera.kill()
        self.camera.wait()
        self.camera = self.start_camera()
        seconds, nanoseconds = map(int, self.camera.stdout.readline().split())
        self.report(f"camera killed and restarted ({', '.join(self.names)})", "pose", seconds + 1e-9 * nanoseconds - 1e-6)

    def end(self):
        for process in (*self.nodes.values(), self.camera):
            process.kill()
            process.wait()


def main():
    prepare_environment()
    binaries = pathlib.Path(sys.argv[1])
    if len(sys.argv) == 2:
        # A process each: rclpy starts once.
        for kind in ("composed", "separate"):
            subprocess.run([sys.executable, __file__, binaries, kind], check=True)
        return
    results = {"slam_node": "pose"} if sys.argv[2] == "composed" else {"segmentation_node": "mask", "tracking_node": "pose"}
    trial = Trial(binaries, list(results))
    try:
        for name, what in results.items():
            trial.suspend(name, what)
            trial.replace(name, what)
        trial.replace_camera()
    finally:
        trial.end()
    # The spinning thread must not outlive the context.
    sys.stdout.flush()
    os._exit(0)


main()
