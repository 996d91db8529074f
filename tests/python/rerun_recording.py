"""Turns a run into a recording for the rerun viewer (pip install rerun-sdk numpy pillow).

usage: rerun_recording.py SEQUENCE RUN_FOLDER FILE.rrd
RUN_FOLDER is what `pfd-slam run SEQUENCE --out RUN_FOLDER --save-masks` wrote. The recording holds images, masks, poses, keyframes,
and the static points seen from the keyframes; `rerun FILE.rrd` shows it.
"""

import sys
from pathlib import Path

import numpy as np
import rerun as rr
from PIL import Image

import tum

ESTIMATE, KEYFRAME = [0, 114, 178], [213, 94, 0]
# Every so many pixels of a keyframe become a point.
STEP = 6
# Depth beyond it is too noisy to draw, metres.
FAR = 4.0
# Steps that take the distortion of a lens out of a pixel to well below what depth is known to.
UNDISTORT_STEPS = 8


def poses(path):
    """Stamp → translation, rotation (x y z w)."""
    rows = np.atleast_2d(np.loadtxt(path))
    return {f"{row[0]:.6f}": (row[1:4], row[4:8]) for row in rows}


def rotation_matrix(q):
    x, y, z, w = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def undistorted(x, y, distortion):
    """Normalised coordinates without the lens's distortion k1 k2 p1 p2 k3 (Brown), by fixed-point iteration."""
    k1, k2, p1, p2, k3 = distortion
    u, v = x, y
    for _ in range(UNDISTORT_STEPS):
        r2 = u * u + v * v
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        tangential_u, tangential_v = 2 * p1 * u * v + p2 * (r2 + 2 * u * u), p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
        u, v = (x - tangential_u) / radial, (y - tangential_v) / radial
    return u, v


def static_points(colour, depth, mask, camera, pose):
    """Points (world) and colours of what does not move."""
    fx, fy, cx, cy = camera[:4]
    v, u = np.mgrid[0 : depth.shape[0] : STEP, 0 : depth.shape[1] : STEP].reshape(2, -1)
    z = depth[v, u] / camera[9]
    kept = (z > 0) & (z < FAR) & (mask[v, u] == 0)
    u, v, z = u[kept], v[kept], z[kept]
    x, y = undistorted((u - cx) / fx, (v - cy) / fy, camera[4:9])
    points = np.stack([x * z, y * z, z], axis=1)
    return points @ rotation_matrix(pose[1]).T + pose[0], colour[v, u]


def main():
    sequence, run, target = map(Path, sys.argv[1:4])
    camera = tum.camera(sequence) or sys.exit(f"{sequence}: the camera is not known")
    estimate, keyframes = poses(run / "trajectory.txt"), poses(run / "keyframe_trajectory.txt")
    rr.init("pfd_slam")
    rr.save(target)
    rr.log("world", rr.ViewCoordinates.RDF, static=True)
    rr.log("world/camera/image", rr.AnnotationContext([(255, "moving", (255, 64, 32))]), static=True)
    rr.log("world/trajectory", rr.LineStrips3D([[p for p, _ in estimate.values()]], colors=[ESTIMATE]), static=True)
    rr.log("world/keyframes", rr.Points3D([p for p, _ in keyframes.values()], colors=[KEYFRAME], radii=0.008), static=True)
    for seconds, _, rgb, depth in tum.pairs(sequence):
        stamp, mask_file = f"{seconds:.6f}", run / "masks" / f"{Path(rgb).stem}.png"
        if not mask_file.exists():
            continue
        rr.set_time("time", timestamp=seconds)
        colour = np.asarray(Image.open(sequence / rgb).convert("RGB"))
        mask = np.asarray(Image.open(mask_file))
        rr.log("world/camera/image", rr.Pinhole(focal_length=camera[:2], principal_point=camera[2:4], resolution=colour.shape[1::-1]))
        rr.log("world/camera/image/rgb", rr.Image(colour).compress(jpeg_quality=80))
        rr.log("world/camera/image/mask", rr.SegmentationImage(mask))
        if stamp in estimate:
            translation, q = estimate[stamp]
            rr.log("world/camera", rr.Transform3D(translation=translation, quaternion=rr.Quaternion(xyzw=q)))
        if stamp in keyframes:
            metres = np.asarray(Image.open(sequence / depth))
            points, colours = static_points(colour, metres, mask, camera, keyframes[stamp])
            rr.log(f"world/map/{stamp}", rr.Points3D(points, colors=colours, radii=0.004))


main()
