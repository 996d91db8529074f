"""Sequences in TUM layout, for the other scripts here."""

import re

# Colour and depth belong together when their stamps differ by no more, seconds.
MAX_DIFFERENCE = 0.02
# fx fy cx cy k1 k2 p1 p2 k3 of the benchmark's cameras.
KNOWN = {
    "1": [517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633],
    "2": [520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172],
    "3": [535.4, 539.2, 320.1, 247.6, 0.0, 0.0, 0.0, 0.0, 0.0],
}


# Columns and rows of their images.
KNOWN_SIZE = 640, 480


def calibration(sequence):
    """The keys of calib.yaml with their values; None where there is no such file."""
    file = sequence / "calib.yaml"
    if not file.exists():
        return None
    pairs = (line.split("#")[0].split(":", 1) for line in file.read_text().splitlines() if ":" in line.split("#")[0])
    return {key.strip(): value.strip() for key, value in pairs}


def size(sequence):
    """Columns and rows of the images; None where calib.yaml does not state them."""
    values = calibration(sequence)
    if values is None:
        return KNOWN_SIZE
    sides = [values.get(side, values.get(f"image_{side}")) for side in ("width", "height")]
    return tuple(map(int, sides)) if all(sides) else None


def camera(sequence):
    """fx fy cx cy k1 k2 p1 p2 k3 and the depth factor; None where the camera is not known."""
    values = calibration(sequence)
    if values is None:
        number = re.search(r"(?:freiburg|fr)([123])", sequence.name)
        return KNOWN[number.group(1)] + [5000.0] if number else None
    distortion = [float(x) for x in values.get("distortion", "[]").strip("[]").split(",") if x.strip()]
    pinhole = [float(values[key]) for key in ("fx", "fy", "cx", "cy")]
    return pinhole + (distortion + [0.0] * 5)[:5] + [float(values.get("depth_factor", 5000))]


def listed(sequence, name):
    lines = (line.split() for line in (sequence / name).read_text().splitlines() if line and not line.startswith("#"))
    return [(float(stamp), stamp, path) for stamp, path in lines]


def pairs(sequence):
    """Each colour image with the depth image nearest in time."""
    depth = listed(sequence, "depth.txt")
    for seconds, stamp, path in listed(sequence, "rgb.txt"):
        nearest = min(depth, key=lambda d: abs(d[0] - seconds))
        if abs(nearest[0] - seconds) <= MAX_DIFFERENCE:
            yield seconds, stamp, path, nearest[2]
