"""Measures the nodes beside an rclpy camera: latency image in -> mask out -> pose out, loss, CPU.

usage: ros_measure.py BIN_DIR {composed,separate} [--seconds 60] [--reliability best_effort] [--sequence DIR] [--mode pfd]
BIN_DIR holds the programs (target/release). The frames of the sequence (the bundled one by default) are played forwards and backwards
at 30 Hz, stamped with the present time. Prints a table row in JSON and a verdict; the exit status is 1 when a frame was lost.
Runs in the Python of ros_install_peers.sh, which needs Pillow for it.
"""

import argparse
import json
import os
import pathlib
import signal
import subprocess
import threading
import time

from ros_camera import RATE, REPOSITORY, Camera, Frames, prepare_environment

START = 3.0  # seconds until everybody knows everybody
DRAIN = 2.0  # seconds after the last frame


def arguments():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("kind", choices=["composed", "separate"])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--reliability", choices=["best_effort", "reliable"], default="best_effort")
    parser.add_argument("--sequence", type=pathlib.Path, default=REPOSITORY / "tests/data/composite-demo")
    parser.add_argument("--mode", default="pfd")
    return parser.parse_args()


class Observer:
    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import Image

        rclpy.init()
        self.node = rclpy.create_node("camera")
        self.sent, self.masks, self.poses, self.diagnostics = {}, {}, {}, {}
        self.node.create_subscription(Image, "dynamic_mask", lambda m: self.arrived(self.masks, m), 10)
        self.node.create_subscription(PoseStamped, "pose", lambda m: self.arrived(self.poses, m), 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnose, 10)
        threading.Thread(target=rclpy.spin, args=(self.node,), daemon=True).start()

    def arrived(self, seen, message):
        stamp = message.header.stamp
        seen[(stamp.sec, stamp.nanosec)] = time.monotonic()

    def diagnose(self, message):
        for status in message.status:
            self.diagnostics[status.name] = {v.key: v.value for v in status.values}

    def latency(self, seen):
        times = sorted(1e3 * (seen[s] - self.sent[s]) for s in seen if s in self.sent)
        return [round(times[int(q * (len(times) - 1))], 1) for q in (0.5, 0.99, 1.0)] if times else None


def cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid):
    line = next(l for l in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines() if l.startswith("VmHWM"))
    return int(line.split()[1]) // 1024


def main():
    args = arguments()
    prepare_environment()
    names = ["slam_node"] if args.kind == "composed" else ["segmentation_node", "tracking_node"]
    options = ["--ros-args", "-p", f"qos:={args.reliability}", "-p", f"mode:={args.mode}", "--log-level", "warn"]
    nodes = [subprocess.Popen([args.bin / name, *options]) for name in names]
    frames, observer = Frames(args.sequence), Observer()
    camera = Camera(observer.node, frames, args.reliability)
    time.sleep(START)
    before = [cpu_seconds(node.pid) for node in nodes]
    begun = time.monotonic()
    for i in range(int(args.seconds * RATE)):
        time.sleep(max(0.0, begun + i / RATE - time.monotonic()))
        sent_at = time.monotonic()
        observer.sent[camera.publish(i)] = sent_at
    seconds = time.monotonic() - begun
    cpu = [round(100 * (cpu_seconds(node.pid) - b) / seconds) for node, b in zip(nodes, before)]
    memory = [memory_mb(node.pid) for node in nodes]
    time.sleep(DRAIN)
    ended = [node.poll() for node in nodes]
    for node in nodes:
        node.send_signal(signal.SIGINT)
    statuses = [node.wait() for node in nodes]
    sent = len(observer.sent)
    lost = {"masks": sent - len(observer.masks), "poses": sent - len(observer.poses)}
    dropped = {name: values.get("dropped (replaced by newer)") for name, values in observer.diagnostics.items() if name.endswith("camera")}
    print(json.dumps({
        "kind": args.kind, "reliability": args.reliability, "seconds": round(seconds, 1), "sent": sent, "lost": lost, "dropped": dropped,
        "mask_ms": observer.latency(observer.masks), "pose_ms": observer.latency(observer.poses),
        "cpu_percent": cpu, "memory_mb": memory, "load": round(os.getloadavg()[0], 1), "exit": statuses,
    }))
    good = not any(lost.values()) and not any(ended[i] is not None for i in range(len(ended))) and not any(statuses)
    print(f"{'OK' if good else 'NOT OK'}: {args.kind}, {args.reliability}: {sent} frames in {seconds:.0f} s, lost {lost}, pose after "
          f"{observer.latency(observer.poses)} ms (median, p99, max)", flush=True)
    # The spinning thread must not outlive the context.
    os._exit(0 if good else 1)


main()
