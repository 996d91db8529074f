"""Starts a node, stops it, and prints whether it is forgotten before its lease runs out: {"seen": bool, "gone": bool, "exit": int}.

usage: ros_goodbye.py PROGRAM
"""

import json
import signal
import subprocess
import sys
import time

import rclpy

LEASE = 50.0  # seconds for which a node that left without a goodbye is still listed
PERIOD = 0.05  # seconds between two looks


def comes_true(condition, seconds):
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(PERIOD)
    return True


def main():
    rclpy.init()
    node = rclpy.create_node("watcher")
    program = sys.argv[1]
    name = program.rsplit("/", 1)[-1]
    process = subprocess.Popen([program])
    seen = comes_true(lambda: name in node.get_node_names() and node.count_publishers("/pose") > 0, 3 * LEASE)
    process.send_signal(signal.SIGINT)
    status = process.wait()
    gone = comes_true(lambda: name not in node.get_node_names() and node.count_publishers("/pose") == 0, LEASE / 2)
    print(json.dumps({"seen": seen, "gone": gone, "exit": status}))


main()
