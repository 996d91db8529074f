"""Runs ORB-SLAM3 (pip install pyorbslam3; GPL, used as a program of its own) on a sequence in TUM layout.

usage: orbslam3.py SEQUENCE TRAJECTORY
Writes the trajectory and prints one line of JSON: frames, tracked share, time per frame. Exits with 77 and the reason where it
cannot run: the package, its libraries or its vocabulary are missing ($PYORBSLAM3_VOCAB names ORBvoc.txt).
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import tum

CANNOT_RUN = 77
# The settings of ORB-SLAM3's own TUM RGB-D examples.
SETTINGS = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {0}
Camera1.fy: {1}
Camera1.cx: {2}
Camera1.cy: {3}
Camera1.k1: {4}
Camera1.k2: {5}
Camera1.p1: {6}
Camera1.p2: {7}
Camera1.k3: {8}
Camera.width: {10}
Camera.height: {11}
Camera.fps: 30
Camera.RGB: 0
Stereo.ThDepth: 40.0
Stereo.b: 0.07732
RGBD.DepthMapFactor: {9}
ORBextractor.nFeatures: 1000
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def cannot_run(reason):
    print(f"ORB-SLAM3 skipped: {reason}", file=sys.stderr)
    sys.exit(CANNOT_RUN)


def start(settings):
    try:
        import pyorbslam3

        import cv2  # noqa: F401: looked for before anything is run
    except (ImportError, OSError) as error:
        cannot_run(f"{error} (pip install pyorbslam3 opencv-python-headless)")
    try:
        vocabulary = pyorbslam3.vocabulary_path(quiet=True)
    except Exception as error:  # noqa: BLE001: whatever the download met
        cannot_run(f"no vocabulary: {error}; PYORBSLAM3_VOCAB names ORBvoc.txt")
    return pyorbslam3.Slam(vocabulary, settings, pyorbslam3.Sensor.RGBD)


def main():
    sequence, trajectory = map(Path, sys.argv[1:3])
    camera = tum.camera(sequence) or cannot_run(f"{sequence}: the camera is not known")
    size = tum.size(sequence) or cannot_run(f"{sequence / 'calib.yaml'}: width and height are missing")
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as settings:
        settings.write(SETTINGS.format(*camera, *size))
        settings.flush()
        slam = start(settings.name)
    import cv2
    import numpy as np

    times, tracked = [], 0
    for seconds, _, rgb, depth in tum.pairs(sequence):
        image = cv2.imread(str(sequence / rgb))
        metres = cv2.imread(str(sequence / depth), cv2.IMREAD_UNCHANGED).astype(np.float32)
        begin = time.perf_counter()
        tracked += slam.track_rgbd(image, metres, seconds).pose_valid
        times.append(1000 * (time.perf_counter() - begin))
    slam.shutdown()
    slam.save_trajectory_tum(str(trajectory))
    median, p99 = np.percentile(times, [50, 99])
    print(json.dumps({"frames": len(times), "tracked": tracked / len(times), "median_ms": median, "p99_ms": p99}))


main()
