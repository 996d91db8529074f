"""Makes test sequences with exact masks: rendered movers in real RGB-D frames.

usage: compose_movers.py DATA --out DIR [NAME ...] [--seed N] [--sheets DIR]     (pip install numpy opencv-python)
DATA holds `tum-fr1-xyz-first180`, `joint-vo-sf-pairs` and `tum-fr3-walking-xyz-stills`. Each sequence gets `rgb/`, `depth/`, `mask/`,
their lists, `groundtruth.txt` and `calib.yaml` in TUM layout. Without names all sequences are made.

The fr1 sequences keep the real camera path. The rooms are single RGB-D images seen by a camera that only rotates (warped with
K R K'^-1 and a longer focal length); people who are in those images stand still and count as static. What walks through the `drawn`
sequences is drawn from the seed, so that another seed makes sequences on which nothing was tuned.

Mask: 255 = moving, 128 = to be ignored, 0 = static. People are 255 as long as they are there, also while they pause. A box that was put
down is 128 for 2.5 s and 0 from then on; what sets off is 0 until it is 2 cm from where it stood. Movers are z-tested against the
real depth (holes take the nearest valid depth). Their depth has noise, disparity quantisation, ragged outlines, nothing nearer than
0.5 m, and a projector shadow on the left; in the fr1 sequences there is none where the real sensor never measured any, along the border.
"""

import argparse
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

import tum

FACTOR, NEAREST, RATE = 5000.0, 0.5, 30.0
WIDTH, HEIGHT = 640, 480
MOVING, IGNORED, STATIC = 255, 128, 0
# Focal length x baseline of the depth sensor, pixel metres; disparity steps per pixel; widest shadow, pixels.
FOCAL_BASELINE, DISPARITY_STEPS, SHADOW = 525 * 0.075, 8, 16
# Seconds for which a box counts as neither moving nor static after it was put down.
SETTLING = 2.5
# How much longer than the real one the focal length of a rotating camera is.
ZOOM = 1.3
LIGHT = np.array([-0.35, -0.5, 0.79])
LATTICE = np.random.default_rng(7).random((32, 32, 32)).astype(np.float32)

# ---------------------------------------------------------------- solids


@dataclass
class Texture:
    """Pattern fixed to a solid: flat, checks, stripes or noise of two colours (BGR, 0..1), `scale` metres wide."""

    kind: str
    a: tuple
    b: tuple = (0, 0, 0)
    scale: float = 0.05

    def colour(self, p: np.ndarray) -> np.ndarray:
        q = p / self.scale
        if self.kind == "checks":
            w = (np.floor(q + 0.5).astype(int).sum(1) & 1).astype(np.float32)
        elif self.kind == "stripes":
            w = (np.floor(q[:, 2]).astype(int) & 1).astype(np.float32)
        elif self.kind == "noise":
            w = np.clip(0.6 * value_noise(q) + 0.4 * value_noise(q * 2.7 + 5), 0, 1)
        else:
            w = 0.12 * value_noise(q)
        return (1 - w[:, None]) * np.float32(self.a) + w[:, None] * np.float32(self.b)


def value_noise(q: np.ndarray) -> np.ndarray:
    """Smooth noise 0..1 at points."""
    cell = np.floor(q).astype(int)
    f = q - cell
    f = f * f * (3 - 2 * f)
    total = np.zeros(len(q), np.float32)
    for i in range(8):
        corner = np.array([i & 1, i >> 1 & 1, i >> 2])
        weight = np.where(corner, f, 1 - f).prod(1)
        x, y, z = ((cell + corner) & 31).T
        total += weight * LATTICE[x, y, z]
    return total


@dataclass
class Solid:
    """Box (half sizes), ellipsoid (half axes) or capsule (radius, radius, half length along z), posed in the world."""

    kind: str
    size: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    texture: Texture
    label: int = MOVING

    def radius(self) -> float:
        if self.kind == "box":
            return float(np.linalg.norm(self.size))
        return float(self.size[0] + self.size[2]) if self.kind == "capsule" else float(max(self.size))

    def hit(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ray parameter (inf where missed) and normals; all in the solid's own frame."""
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.kind == "box":
                near = (-np.sign(d) * self.size - o) / d
                far = (np.sign(d) * self.size - o) / d
                axis = near.argmax(1)
                t = near.max(1)
                t = np.where((t <= far.min(1)) & (t > 0.05), t, np.inf)
                normal = -np.sign(d) * (np.arange(3) == axis[:, None])
                return t, normal
            if self.kind == "ellipsoid":
                t = nearest_root(o / self.size, d / self.size, 1.0)
                p = o + np.where(np.isfinite(t), t, 0)[:, None] * d
                return t, p / self.size**2
            r, h = self.size[0], self.size[2]
            t = nearest_root(o[:2], d[:, :2], r)
            t = np.where(np.abs(o[2] + t * d[:, 2]) <= h, t, np.inf)
            for end in (-h, h):
                cap = nearest_root(o - [0, 0, end], d, r)
                cap = np.where((o[2] + cap * d[:, 2]) * np.sign(end) >= h, cap, np.inf)
                t = np.minimum(t, cap)
            p = o + np.where(np.isfinite(t), t, 0)[:, None] * d
            return t, p - np.stack([0 * t, 0 * t, np.clip(p[:, 2], -h, h)], 1)


def nearest_root(o: np.ndarray, d: np.ndarray, r: float) -> np.ndarray:
    """First t > 0.05 with |o + t d| = r; inf where there is none."""
    a, b, c = (d * d).sum(1), d @ o, o @ o - r * r
    t = (-b - np.sqrt(b * b - a * c)) / a
    return np.where(t > 0.05, t, np.inf)


def limb(a: np.ndarray, b: np.ndarray, r: float, side: np.ndarray, texture: Texture) -> Solid:
    """Capsule from a to b."""
    z = (b - a) / max(np.linalg.norm(b - a), 1e-6)
    x = np.cross(side, z)
    x /= max(np.linalg.norm(x), 1e-6)
    size = np.array([r, r, np.linalg.norm(b - a) / 2])
    return Solid("capsule", size, np.stack([x, np.cross(z, x), z], 1), (a + b) / 2, texture)


def yaw(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


# ---------------------------------------------------------------- movers, in ground coordinates: right, forward, up


class Track:
    """Smooth path through waypoints (seconds, right, forward), with heading and phase of the gait."""

    def __init__(self, *waypoints: tuple):
        w = np.array(waypoints, float)
        self.t = np.arange(w[0, 0] - 2, w[-1, 0] + 2, 0.01)
        self.p = np.stack([self.smooth(np.interp(self.t, w[:, 0], w[:, k])) for k in (1, 2)], 1)
        v = np.gradient(self.p, 0.01, axis=0)
        self.v = np.hypot(*v.T)
        going = np.flatnonzero(self.v > 0.15)
        last = going[np.clip(np.searchsorted(going, np.arange(len(self.t)), side="right") - 1, 0, None)]
        self.heading = self.smooth(np.unwrap(np.arctan2(v[last, 1], v[last, 0])))
        self.phase = 2 * np.pi * np.cumsum(self.v) * 0.01 / 1.35

    @staticmethod
    def smooth(x: np.ndarray) -> np.ndarray:
        return np.convolve(np.pad(x, 17, "edge"), np.ones(35) / 35, "valid")

    def at(self, t: float) -> tuple[np.ndarray, float, float, float]:
        """Place, heading, phase, speed."""
        f = [np.interp(t, self.t, x) for x in (*self.p.T, self.heading, self.phase, self.v)]
        return np.array([f[0], f[1], 0]), f[2], f[3], f[4]


@dataclass
class Looks:
    height: float
    shirt: Texture
    trousers: Texture
    hair: tuple = (0.08, 0.1, 0.14)
    skin: tuple = (0.5, 0.6, 0.82)


def person(track: Track, looks: Looks, t: float, held: np.ndarray | None = None, holding: float = 0.0) -> list[Solid]:
    """Walker; the hands are drawn towards `held` by the weight `holding`."""
    place, heading, phase, speed = track.at(t)
    swing, k = min(speed / 0.6, 1.0), looks.height / 1.75
    frame = yaw(heading)
    place = place + [0, 0, 0.02 * swing * np.cos(2 * phase)]
    point = lambda x, y, z: place + k * (frame @ np.array([x, y, z]))
    side, skin, hair = frame[:, 1], Texture("flat", looks.skin), Texture("noise", looks.hair, tuple(2 * c for c in looks.hair), 0.02)
    shoes = Texture("flat", (0.1, 0.1, 0.12))
    solid = lambda size, at, texture: Solid("ellipsoid", k * np.array(size), frame, at, texture)
    parts = [
        limb(point(0, 0, 0.98), point(0, 0, 1.33), 0.135 * k, side, looks.shirt),
        solid([0.13, 0.205, 0.19], point(0, 0, 1.3), looks.shirt),
        solid([0.135, 0.18, 0.16], point(0, 0, 0.95), looks.trousers),
        limb(point(0, 0, 1.42), point(0.02, 0, 1.55), 0.055 * k, side, skin),
        solid([0.1, 0.078, 0.12], point(0.02, 0, 1.635), skin),
        solid([0.1, 0.086, 0.1], point(0, 0, 1.67), hair),
    ]
    for left in (-1, 1):
        a = left * 0.42 * swing * np.sin(phase)
        bend = swing * 0.75 * max(0.0, -left * np.cos(phase)) + 0.05
        hip = np.array([0, left * 0.09, 0.9])
        knee = hip + 0.42 * np.array([np.sin(a), 0, -np.cos(a)])
        ankle = knee + 0.42 * np.array([np.sin(a - bend), 0, -np.cos(a - bend)])
        parts += [
            limb(point(*hip), point(*knee), 0.08 * k, side, looks.trousers),
            limb(point(*knee), point(*ankle), 0.058 * k, side, looks.trousers),
            solid([0.13, 0.05, 0.045], point(*(ankle + [0.06, 0, -0.02])), shoes),
        ]
        a = -left * 0.45 * swing * np.sin(phase)
        shoulder = np.array([0, left * 0.21, 1.42])
        elbow = shoulder + 0.29 * np.array([np.sin(a), left * 0.12, -np.cos(a)])
        hand = elbow + 0.27 * np.array([np.sin(a + 0.35), 0, -np.cos(a + 0.35)])
        shoulder, elbow, hand = (point(*x) for x in (shoulder, elbow, hand))
        if held is not None:
            grip = held + left * 0.1 * side
            hand = (1 - holding) * hand + holding * grip
            elbow = (1 - holding) * elbow + holding * ((shoulder + grip) / 2 - [0, 0, 0.12])
        wrist = elbow + 0.55 * (hand - elbow)
        parts += [
            limb(shoulder, elbow, 0.052 * k, side, looks.shirt),
            limb(elbow, wrist, 0.045 * k, side, looks.shirt),
            limb(wrist, hand, 0.036 * k, side, skin),
            solid([0.05, 0.04, 0.055], hand, skin),
        ]
    return parts


def box(size: tuple, centre: np.ndarray, rotation: np.ndarray, texture: Texture, label: int = MOVING) -> Solid:
    return Solid("box", np.array(size) / 2, rotation, np.asarray(centre, float), texture, label)


def ball(radius: float, centre: np.ndarray, spin: float, texture: Texture) -> Solid:
    return Solid("ellipsoid", np.full(3, radius), yaw(spin) @ rodrigues([spin, 0, 0]), np.asarray(centre, float), texture)


def bouncing(t: float, start: tuple, velocity: tuple, floor: float, radius: float) -> np.ndarray:
    """Centre of a ball that loses a fifth of its speed at each bounce."""
    p, vz = np.array(start, float), float(velocity[2])
    for _ in range(int(max(t, 0) / 0.002)):
        vz -= 9.81 * 0.002
        p += np.array([velocity[0], velocity[1], vz]) * 0.002
        if p[2] < floor + radius and vz < 0:
            vz = -0.8 * vz
    return p


def rodrigues(v: list) -> np.ndarray:
    return cv2.Rodrigues(np.array(v, float))[0]


def ramp(t: float, a: float, b: float) -> float:
    """0 before a, 1 after b, smooth between."""
    x = np.clip((t - a) / (b - a), 0, 1)
    return float(x * x * (3 - 2 * x))


PLAIN_GREY = Looks(1.78, Texture("flat", (0.45, 0.43, 0.42), (0.2, 0.2, 0.2), 0.2), Texture("flat", (0.28, 0.2, 0.16), scale=0.1))
CHECKED = Looks(1.7, Texture("checks", (0.2, 0.2, 0.7), (0.75, 0.8, 0.8), 0.06), Texture("noise", (0.35, 0.22, 0.15), (0.6, 0.45, 0.35), 0.03))
STRIPED = Looks(1.82, Texture("stripes", (0.55, 0.3, 0.12), (0.8, 0.78, 0.75), 0.05), Texture("flat", (0.16, 0.16, 0.17), scale=0.1))
MOTTLED = Looks(1.66, Texture("noise", (0.15, 0.45, 0.2), (0.6, 0.85, 0.7), 0.035), Texture("flat", (0.42, 0.5, 0.56), scale=0.1), (0.15, 0.3, 0.5))

ALL_LOOKS = [CHECKED, STRIPED, MOTTLED, PLAIN_GREY]

# A mover that sets off counts as static until it is this far from where it stood, metres: before, no sensor tells the difference.
SET_OFF = 0.02

Scene = Callable[[float], list[Solid]]


def drawn(rng: np.random.Generator) -> Scene:
    """One to three walkers whose looks and ways are drawn: each comes from one side, mostly pauses, and leaves at a side."""
    walkers = []
    for looks in rng.permutation(len(ALL_LOOKS))[: rng.integers(1, 4)]:
        start, come, rest, leave = np.cumsum(rng.uniform((-0.5, 1.0, 0.0, 1.0), (1.5, 2.5, 1.5, 2.5)))
        sides, middle = rng.choice([-1.6, 1.6], 2), rng.uniform(-0.6, 0.6)
        near = rng.uniform(0.8, 2.2, 3)
        here = (middle, near[1])
        track = Track((start, sides[0], near[0]), (come, *here), (rest, *here), (leave, sides[1], near[2]))
        walkers.append((track, ALL_LOOKS[looks]))
    return lambda t: [part for track, looks in walkers for part in person(track, looks, t)]


def three_people() -> Scene:
    """Three walkers at three depths; one pauses for 1.5 s, another comes back."""
    a = Track((0, -1.0, 1.0), (1.3, -0.3, 1.0), (2.8, -0.3, 1.0), (3.5, 0.05, 0.68), (5.2, 1.3, 0.7))
    b = Track((-0.2, 1.1, 1.35), (3.2, -1.35, 1.4), (3.7, -1.35, 1.15), (6.2, 0.9, 1.1))
    c = Track((1.4, -1.9, 2.0), (4.4, 1.2, 2.0), (4.8, 1.2, 1.9), (6.4, -0.7, 1.8))
    return lambda t: person(a, CHECKED, t) + person(b, PLAIN_GREY, t) + person(c, STRIPED, t)


def box_put_down() -> Scene:
    """A person brings a box, puts it onto the desk and leaves."""
    track = Track((0.1, -1.5, 0.9), (1.5, -0.44, 0.76), (2.5, -0.44, 0.76), (4.1, -1.7, 0.95))
    rest, size, down = np.array([-0.01, 0.68, 0.84]), (0.14, 0.18, 0.14), 2.2
    pattern = Texture("checks", (0.35, 0.5, 0.7), (0.3, 0.43, 0.62), 0.045)

    def scene(t: float) -> list[Solid]:
        place, heading, _, _ = track.at(min(t, down))
        lowering, leaving = ramp(t, 1.55, down), ramp(t, down, down + 0.35)
        held = (1 - lowering) * (place + yaw(heading) @ np.array([0.4, 0, 1.0])) + lowering * rest
        label = MOVING if t < down else IGNORED if t < down + SETTLING else STATIC
        angle = (1 - lowering) * heading + lowering * 0.3
        return person(track, MOTTLED, t, held, 1 - leaving) + [box(size, held, yaw(angle), pattern, label)]

    return scene


def things() -> Scene:
    """Nearly untextured: a ball that bounces across three times, a swinging door, a low robot on the desk."""
    robot = Track((-0.2, 0.65, 0.62), (2.2, 0.03, 0.64), (4.2, 0.42, 0.66), (6.4, 0.0, 0.66))
    throws = [(0.3, (-1.0, 0.7, 1.15), (2.1, 0.1, 0.6)), (2.2, (1.0, 1.1, 1.3), (-1.9, -0.25, 0.8)), (4.2, (-0.6, 1.35, 1.15), (0.75, -0.9, 0.7))]

    def scene(t: float) -> list[Solid]:
        swing = np.pi - 0.25 - 1.1 * (1 - np.cos(2 * np.pi * t / 3.1)) / 2 * (1 + 0.35 * np.sin(0.9 * t))
        leaf = yaw(swing)
        hinge = np.array([-0.1, 1.45, 1.28])
        parts = [box((0.8, 0.03, 1.0), hinge + leaf @ np.array([0.4, 0, 0]), leaf, Texture("flat", (0.55, 0.66, 0.74), (0.4, 0.5, 0.55), 0.3))]
        place, heading, _, _ = robot.at(t)
        body, turned = Texture("flat", (0.3, 0.3, 0.32), (0.1, 0.1, 0.1), 0.1), yaw(heading)
        parts.append(box((0.2, 0.15, 0.07), place + [0, 0, 0.825], turned, body))
        parts.append(box((0.08, 0.1, 0.05), place + [0, 0, 0.885], turned, Texture("flat", (0.2, 0.5, 0.8))))
        for start, at, velocity in throws:
            if 0 <= t - start < 1.7:
                texture = Texture("flat", (0.2, 0.35, 0.85), (0.1, 0.2, 0.5), 0.06)
                parts.append(ball(0.085, bouncing(t - start, at, velocity, 0.77, 0.085), 4 * t, texture))
        return parts

    return scene


def labelled(parts: list[Solid], label: int) -> list[Solid]:
    return [replace(part, label=label) for part in parts]


def sets_off(track: Track, parts: Callable[[float], list[Solid]]) -> Scene:
    """Static until `track` leaves its beginning."""
    away = lambda t: np.linalg.norm(track.at(t)[0] - track.at(0)[0]) > SET_OFF
    onset = next(t for t in track.t if t > 0 and away(t))
    return lambda t: labelled(parts(t), MOVING if t >= onset else STATIC)


def box_sets_off() -> Scene:
    """A patterned box is drawn over the desk after two seconds."""
    track = Track((0, -0.05, 0.75), (2.2, -0.05, 0.75), (3.4, 0.45, 0.7), (4.8, -0.1, 0.75), (6.4, 0.4, 0.7))
    pattern = Texture("checks", (0.35, 0.5, 0.7), (0.3, 0.43, 0.62), 0.045)
    return sets_off(track, lambda t: [box((0.18, 0.14, 0.14), track.at(t)[0] + [0, 0, 0.84], yaw(0.2), pattern)])


def plain_sets_off() -> Scene:
    """The low, plain robot on the desk sets off after two seconds."""
    track = Track((0, 0.35, 0.7), (2.2, 0.35, 0.7), (4.0, -0.2, 0.66), (6.4, 0.2, 0.66))
    body = Texture("flat", (0.3, 0.3, 0.32), (0.1, 0.1, 0.1), 0.1)
    return sets_off(track, lambda t: [box((0.2, 0.15, 0.09), track.at(t)[0] + [0, 0, 0.825], yaw(0.3), body)])


def walker_sets_off(looks: Looks, *waypoints: tuple) -> Callable[[], Scene]:
    """Somebody stands for two seconds, then walks away."""
    track = Track(*waypoints)
    return lambda: sets_off(track, lambda t: person(track, looks, t))


def room_a() -> Scene:
    """One walker to and fro before the shelf, one who comes as near as 0.7 m."""
    a = Track((-0.2, -1.1, 1.6), (2.0, 1.0, 1.75), (2.4, 1.0, 1.65), (5.2, -0.55, 1.5))
    b = Track((0.3, 1.2, 2.05), (1.3, 0.5, 1.75), (2.9, 0.22, 0.85), (3.4, 0.22, 0.85), (3.9, 0.0, 1.0), (5.3, -0.6, 1.8))
    return lambda t: person(a, STRIPED, t) + person(b, MOTTLED, t)


def room_b() -> Scene:
    """One walker behind the people of the room, one who comes as near as 0.7 m and goes away again."""
    a = Track((0.2, 1.3, 2.1), (2.4, -0.75, 1.9), (2.9, -0.75, 1.85), (5.0, 1.0, 1.95))
    b = Track((-0.2, -1.0, 1.15), (1.6, -0.12, 0.87), (2.2, -0.12, 0.87), (3.2, 0.2, 1.7), (4.2, 0.2, 2.2), (5.2, -0.8, 2.3))
    return lambda t: person(a, CHECKED, t) + person(b, PLAIN_GREY, t)


def room_c() -> Scene:
    """A box that is borne about and a ball that bounces through twice."""
    path = Track((-0.2, -1.2, 1.7), (1.6, 0.1, 1.5), (2.2, 0.2, 1.5), (3.4, -0.4, 2.1), (5.2, 0.7, 1.4))
    cardboard = Texture("noise", (0.33, 0.5, 0.68), (0.28, 0.42, 0.6), 0.08)
    throws = [(0.6, (1.4, 1.9, 1.3), (-2.2, -0.2, 1.2)), (3.0, (-1.2, 1.6, 1.2), (2.4, 0.1, 1.4))]

    def scene(t: float) -> list[Solid]:
        place, heading, phase, _ = path.at(t)
        turned = yaw(heading) @ rodrigues([0.08 * np.sin(phase), 0.06 * np.sin(1.7 * t), 0])
        parts = [box((0.45, 0.34, 0.3), place + [0, 0, 1.15 + 0.03 * np.cos(2 * phase)], turned, cardboard)]
        for start, at, velocity in throws:
            if 0 <= t - start < 1.6:
                parts.append(ball(0.12, bouncing(t - start, at, velocity, 0.35, 0.12), 5 * t, Texture("checks", (0.85, 0.85, 0.8), (0.2, 0.25, 0.8), 0.11)))
        return parts

    return scene


# ---------------------------------------------------------------- rendering


def rays_of(camera: list) -> np.ndarray:
    """Ray with z = 1 of every pixel, distortion undone."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    pixels = np.stack([u.ravel(), v.ravel()], 1)[:, None].astype(np.float64)
    fx, fy, cx, cy = camera[:4]
    xy = cv2.undistortPoints(pixels, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array(camera[4:9]))[:, 0]
    return np.c_[xy, np.ones(len(xy))].reshape(HEIGHT, WIDTH, 3)


def render(solids: list[Solid], rays: np.ndarray, pose: tuple, tint: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth (inf = none), colour 0..255 and label of the movers; pose = rotation and place of the camera."""
    rotation, place = pose
    z, colour, label = np.full((HEIGHT, WIDTH), np.inf), np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.uint8)
    coarse = rays[4::8, 4::8]
    coarse = coarse / np.linalg.norm(coarse, axis=2, keepdims=True)
    light = LIGHT / np.linalg.norm(LIGHT)
    for s in solids:
        c = rotation.T @ (s.centre - place)
        along = coarse @ c
        reach = s.radius() * 1.05 + 0.02 * np.linalg.norm(c)
        rows, columns = np.nonzero((c @ c - along**2 < reach**2) & (along > -reach))
        if c[2] < -s.radius() or len(rows) == 0:
            continue
        window = np.s_[rows.min() * 8 : rows.max() * 8 + 8, columns.min() * 8 : columns.max() * 8 + 8]
        d = rays[window].reshape(-1, 3) @ (s.rotation.T @ rotation).T
        o = s.rotation.T @ (place - s.centre)
        t, normal = s.hit(o, d)
        won = t.reshape(z[window].shape) < z[window]
        if not won.any():
            continue
        i = won.ravel()
        n = normal[i] / np.maximum(np.linalg.norm(normal[i], axis=1, keepdims=True), 1e-9)
        facing = np.abs((n * d[i]).sum(1)) / np.linalg.norm(d[i], axis=1)
        shade = 0.45 + 0.35 * np.maximum(n @ (s.rotation.T @ light), 0) + 0.2 * facing
        z[window][won] = t[i]
        colour[window][won] = 255 * s.texture.colour((o + t[i, None] * d[i]).astype(np.float32)) * shade[:, None] * tint
        label[window][won] = s.label
    return z, colour, label


def filled(depth: np.ndarray) -> np.ndarray:
    """Holes take the nearest valid depth."""
    holes = (depth == 0).astype(np.uint8)
    if holes.all():
        return np.full(depth.shape, np.inf)
    _, index = cv2.distanceTransformWithLabels(holes, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.zeros(index.max() + 1)
    table[index[holes == 0]] = depth[holes == 0]
    return table[index]


def sensed(z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise and disparity quantisation; 0 = none."""
    valid = np.isfinite(z) & (z > NEAREST)
    clean = np.where(valid, z, 1.0)
    noisy = clean + (0.0012 + 0.0019 * (clean - 0.4) ** 2) * rng.standard_normal(z.shape)
    disparity = np.round(FOCAL_BASELINE / noisy * DISPARITY_STEPS) / DISPARITY_STEPS
    return np.where(valid, FOCAL_BASELINE / np.maximum(disparity, 1), 0)


def with_colour(image: np.ndarray, colour: np.ndarray, visible: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Movers over the image; the outline is blended over about a pixel."""
    out = np.where(visible[..., None], colour + 2.0 * rng.standard_normal(colour.shape).astype(np.float32), image.astype(np.float32))
    v, kernel = visible.astype(np.uint8), np.ones((3, 3), np.uint8)
    outline = cv2.dilate(v, kernel) != cv2.erode(v, kernel)
    out[outline] = cv2.GaussianBlur(out, (3, 3), 0.7)[outline]
    return np.clip(out, 0, 255).astype(np.uint8)


def with_depth(depth: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Movers in a depth map (metres) as a structured-light sensor would see them."""
    behind = filled(depth)
    visible = z < behind
    if not visible.any():
        return depth
    noise = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 1.5)
    noise *= 1.1 / noise.std()
    inside = cv2.distanceTransform(visible.astype(np.uint8), cv2.DIST_L2, 3)
    outside = cv2.distanceTransform((~visible).astype(np.uint8), cv2.DIST_L2, 3)
    grown = cv2.erode(np.where(visible, z, 1e3), np.ones((5, 5), np.uint8))
    lost = visible & (inside < noise + 0.3)
    gained = ~visible & (outside < -noise - 0.3) & (outside <= 2) & (grown < behind)
    measured = sensed(np.where(gained, grown, z), rng)
    out = np.where((visible & ~lost) | gained, measured, depth)
    out[lost] = np.where(rng.random(lost.sum()) < 0.5, 0, out[lost])
    out[lost & (depth > 0) & (rng.random(depth.shape) < 0.5)] = 0
    shadow = np.zeros(depth.shape, bool)
    mover = np.where(visible, z, np.inf)
    for w in range(1, SHADOW + 1):
        shadow[:, :-w] |= FOCAL_BASELINE * (1 / mover[:, w:] - 1 / behind[:, :-w]) >= w
    out[shadow & ~visible & ~gained] = 0
    return out


# ---------------------------------------------------------------- cameras


def matrix(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def quaternion(r: np.ndarray) -> np.ndarray:
    """x y z w."""
    v = cv2.Rodrigues(r)[0].ravel()
    angle = np.linalg.norm(v)
    return np.r_[np.sin(angle / 2) * v / max(angle, 1e-12), np.cos(angle / 2)]


class Path3:
    """Ground truth: rows stamp, translation, quaternion."""

    def __init__(self, rows: np.ndarray):
        self.rows = rows.copy()
        flips = np.cumprod(np.r_[1, np.where((rows[1:, 4:] * rows[:-1, 4:]).sum(1) < 0, -1, 1)])
        self.rows[:, 4:] *= flips[:, None]

    def row(self, t: float) -> np.ndarray:
        r = np.array([np.interp(t, self.rows[:, 0], self.rows[:, k]) for k in range(1, 8)])
        r[3:] /= np.linalg.norm(r[3:])
        return r

    def pose(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        r = self.row(t)
        return matrix(r[3:]), r[:3]


def shaken(seconds: float, rng: np.random.Generator) -> Callable[[float], np.ndarray]:
    """Hand-held rotation vector (pitch, yaw, roll) in degrees: pauses, slow drifts, fast turns, and some tremor."""
    times, keys, fast = [0.0], [np.zeros(3)], False
    while times[-1] < seconds:
        target = np.array([rng.uniform(-2.8, 2.8), rng.choice([-1, 1]) * rng.uniform(2, 5), rng.uniform(-2, 2)])
        fast = not fast
        times.append(times[-1] + (np.abs(target - keys[-1]).max() * 1.5 / rng.uniform(25, 34) if fast else rng.uniform(0.6, 1.3)))
        keys.append(target)
        if rng.random() < 0.4:
            times.append(times[-1] + rng.uniform(0.1, 0.4))
            keys.append(target + rng.uniform(-0.1, 0.1, 3))
    times, keys = np.array(times), np.array(keys)
    tremor = [(rng.uniform(2, 6), rng.uniform(0.02, 0.09), rng.uniform(0, 6.3, 3)) for _ in range(4)]

    def angles(t: float) -> np.ndarray:
        i = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2))
        w = ramp(t, times[i], times[i + 1])
        return (1 - w) * keys[i] + w * keys[i + 1] + sum(a * np.sin(2 * np.pi * f * t + p) for f, a, p in tremor)

    return angles


# ---------------------------------------------------------------- sequences


class Writer:
    """Folder in TUM layout."""

    def __init__(self, folder: Path, camera: list, note: str, size: tuple = (WIDTH, HEIGHT)):
        self.folder, self.lists, self.sheet = folder, {"rgb": [], "depth": [], "mask": []}, []
        for name in self.lists:
            (folder / name).mkdir(parents=True, exist_ok=True)
            for old in (folder / name).iterdir():
                old.unlink()
        fields = "".join(f"{key}: {value:.10g}\n" for key, value in zip(("fx", "fy", "cx", "cy"), camera))
        distortion = ", ".join(f"{x:.10g}" for x in camera[4:9])
        (folder / "calib.yaml").write_text(
            f"# {note}\nwidth: {size[0]}\nheight: {size[1]}\n{fields}distortion_model: radtan   # k1 k2 p1 p2 k3\n"
            f"distortion: [{distortion}]\ndepth_factor: {FACTOR:.0f}\n"
        )

    def image(self, kind: str, stamp: float, image: np.ndarray) -> None:
        path = f"{kind}/{stamp:.6f}.{'jpg' if kind == 'rgb' else 'png'}"
        cv2.imwrite(str(self.folder / path), image, [cv2.IMWRITE_JPEG_QUALITY, 95] if kind == "rgb" else [])
        self.lists[kind].append(f"{stamp:.6f} {path}\n")

    def depth(self, stamp: float, metres: np.ndarray) -> None:
        self.image("depth", stamp, np.clip(np.round(metres * FACTOR), 0, 65535).astype(np.uint16))

    def close(self, truth: list[tuple[float, np.ndarray]]) -> None:
        for kind, lines in self.lists.items():
            (self.folder / f"{kind}.txt").write_text("# timestamp filename\n" + "".join(sorted(lines)))
        rows = (f"{t:.4f} " + " ".join(f"{x:.6f}" for x in row) + "\n" for t, row in truth)
        (self.folder / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "".join(rows))


def note_sheet(writer: Writer, image: np.ndarray, mask: np.ndarray, depth: np.ndarray) -> None:
    """Small picture for the contact sheet: colour with tinted mask, depth below."""
    tinted = image.copy()
    tinted[mask == MOVING] = tinted[mask == MOVING] * 0.7 + np.array([0, 0, 76])
    tinted[mask == IGNORED] = tinted[mask == IGNORED] * 0.7 + np.array([76, 76, 0])
    shown = cv2.applyColorMap(np.clip(depth * 80, 0, 255).astype(np.uint8), cv2.COLORMAP_JET) * (depth > 0)[..., None].astype(np.uint8)
    writer.sheet.append(cv2.resize(np.vstack([tinted, shown]), (320, 480), interpolation=cv2.INTER_AREA))


def save_sheet(writer: Writer, file: Path) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = [writer.sheet[i : i + 5] for i in range(0, len(writer.sheet), 5)]
    cv2.imwrite(str(file), np.vstack([np.hstack(row + [np.zeros_like(row[0])] * (5 - len(row))) for row in rows]))


class Fr1:
    """The real static sequence."""

    def __init__(self, data: Path):
        self.folder = data / "tum-fr1-xyz-first180"
        self.path = Path3(np.loadtxt(self.folder / "groundtruth.txt"))
        self.rgb = [(s, self.folder / p) for s, _, p in tum.listed(self.folder, "rgb.txt")]
        self.depth = [(s, self.folder / p) for s, _, p in tum.listed(self.folder, "depth.txt")]
        # Registered to the colour camera, the depth image ends before that does.
        self.measurable = np.any([metres(path) > 0 for _, path in self.depth], axis=0)

    def nearest_depth(self, stamp: float) -> tuple[float, Path]:
        return min(self.depth, key=lambda d: abs(d[0] - stamp))

    def ground(self) -> tuple[np.ndarray, np.ndarray]:
        """Axes right, forward, up (columns) and origin below the first camera; the world's z points up."""
        rotation, place = self.path.pose(self.rgb[0][0])
        forward = rotation[:, 2] * [1, 1, 0]
        forward /= np.linalg.norm(forward)
        return np.stack([np.cross(forward, [0, 0, 1]), forward, [0, 0, 1]], 1), place * [1, 1, 0]


def metres(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / FACTOR


def compose_fr1(data: Path, folder: Path, scene: Scene, rng: np.random.Generator) -> Writer:
    source, camera = Fr1(data), tum.KNOWN["1"]
    axes, origin = source.ground()
    rays, tint, start = rays_of(camera), np.ones(3, np.float32), source.rgb[0][0]
    writer = Writer(folder, camera, "freiburg1 camera (colour and registered depth); images are NOT rectified")

    def seen(stamp: float):
        rotation, place = source.path.pose(stamp)
        return render(scene(stamp - start), rays, (axes.T @ rotation, axes.T @ (place - origin)), tint)

    composed = {}
    for stamp, path in source.depth:
        composed[stamp] = with_depth(metres(path), seen(stamp)[0], rng) * source.measurable
        writer.depth(stamp, composed[stamp])
    for i, (stamp, path) in enumerate(source.rgb):
        z, colour, label = seen(stamp)
        nearest = source.nearest_depth(stamp)
        visible = z < filled(metres(nearest[1]))
        image, mask = with_colour(cv2.imread(str(path)), colour, visible, rng), np.where(visible, label, 0).astype(np.uint8)
        writer.image("rgb", stamp, image)
        writer.image("mask", stamp, mask)
        if i % 9 == 4:
            note_sheet(writer, image, mask, composed[nearest[0]])
    rows = source.path.rows
    kept = (rows[:, 0] > start - 1) & (rows[:, 0] < source.rgb[-1][0] + 1)
    writer.close([(row[0], row[1:]) for row in rows[kept]])
    return writer


def compose_fast(data: Path, folder: Path) -> Writer:
    """Every third frame at 30 Hz, to the end and back over the frames in between; no movers. It turns where the camera is slowest."""
    source = Fr1(data)
    stamps = np.array([s for s, _ in source.rgb])
    places = np.array([source.path.row(s)[:3] for s in stamps])
    last = 150 + int(np.linalg.norm(np.gradient(places, axis=0), axis=1)[150:-1].argmin())
    order = [*range(last % 3, last + 1, 3), *range(last - 2, -1, -3)]
    turn = len(range(last % 3, last + 1, 3)) - 1
    writer = Writer(folder, tum.KNOWN["1"], "freiburg1 camera (colour and registered depth); images are NOT rectified")
    begin = stamps[order[0]]
    new = begin + np.arange(len(order)) / RATE
    for i, k in enumerate(order):
        stamp, depth_path = source.nearest_depth(stamps[k])
        image, depth = cv2.imread(str(source.rgb[k][1])), metres(depth_path)
        writer.image("rgb", new[i], image)
        writer.image("mask", new[i], np.zeros((HEIGHT, WIDTH), np.uint8))
        writer.depth(new[i] + (stamp - stamps[k]) / 3 * (1 if i <= turn else -1), depth)
        if i % 6 == 3:
            note_sheet(writer, image, np.zeros((HEIGHT, WIDTH), np.uint8), depth)
    times = np.arange(begin, new[-1], 0.01)
    writer.close([(t, source.path.row(np.interp(t, new, stamps[order]))) for t in [*times, new[-1]]])
    return writer


@dataclass
class Room:
    """One RGB-D image; height and upward pitch (degrees) of its camera are estimates, they only say where the ground is."""

    colour: str
    depth: str
    camera: list
    height: float
    pitch: float
    tint: tuple


def compose_room(data: Path, folder: Path, room: Room, scene: Scene, rng: np.random.Generator, frames: int = 150) -> Writer:
    colour, depth = cv2.imread(str(data / room.colour)), metres(data / room.depth)
    fx, fy, cx, cy = room.camera
    camera = [ZOOM * fx, ZOOM * fy, 319.5, 239.5, 0, 0, 0, 0, 0]
    rays = rays_of(camera)
    writer = Writer(folder, camera, "virtual camera that rotates in one RGB-D image; no distortion")
    level = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)  # camera axes (right, down, forward) in ground axes
    base = level @ rodrigues([np.radians(room.pitch), 0, 0])
    angles, place = shaken(frames / RATE, rng), np.array([0, 0, room.height])
    start, tint = 1000.0, np.float32(room.tint)
    turned = lambda t: rodrigues(list(np.radians(angles(t))))
    for i in range(frames):
        t = i / RATE
        s = rays @ turned(t).T
        u, v = (np.float32(fx * s[..., 0] / s[..., 2] + cx), np.float32(fy * s[..., 1] / s[..., 2] + cy))
        image = cv2.remap(colour, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        image = np.clip(image + 1.5 * rng.standard_normal(image.shape), 0, 255).astype(np.uint8)
        real = cv2.remap(depth, u, v, cv2.INTER_NEAREST, borderValue=0) / s[..., 2]
        z, rendered, label = render(scene(t), rays, (base @ turned(t), place), tint)
        visible = z < filled(real)
        image, mask = with_colour(image, rendered, visible, rng), np.where(visible, label, 0).astype(np.uint8)
        measured = with_depth(sensed(real, rng), z, rng)
        writer.image("rgb", start + t, image)
        writer.image("mask", start + t, mask)
        writer.depth(start + t, measured)
        if i % 8 == 4:
            note_sheet(writer, image, mask, measured)
    times = np.arange(0, (frames - 1) / RATE + 0.01, 0.01)
    writer.close([(start + t, np.r_[place, quaternion(base @ turned(t))]) for t in times])
    return writer


PAIRS, GUESSED = "joint-vo-sf-pairs", [525.0, 525.0, 319.5, 239.5]
ROOM_A = Room(f"{PAIRS}/opening-door/rgb/0.png", f"{PAIRS}/opening-door/depth/0.png", GUESSED, 1.4, 8, (0.62, 0.5, 0.48))
ROOM_B = Room(f"{PAIRS}/two-people-moving/rgb/0.png", f"{PAIRS}/two-people-moving/depth/0.png", GUESSED, 1.2, 0, (0.62, 0.52, 0.5))
ROOM_C = Room(
    "tum-fr3-walking-xyz-stills/rgb/1341846313.592026.png",
    "tum-fr3-walking-xyz-stills/depth/1341846313.592088.png",
    tum.KNOWN["3"][:4], 1.42, -10.6, (1, 1, 1),
)
ROOMS = {
    "room-a-people": (ROOM_A, room_a), "room-b-people": (ROOM_B, room_b), "room-c-things": (ROOM_C, room_c),
    "room-a-sets-off": (ROOM_A, walker_sets_off(STRIPED, (0, -0.2, 1.6), (2.2, -0.2, 1.6), (4.2, 1.1, 1.7), (5.2, 1.1, 1.7))),
    "room-b-sets-off": (ROOM_B, walker_sets_off(PLAIN_GREY, (0, -0.1, 1.5), (2.2, -0.1, 1.5), (4.2, 1.2, 1.6), (5.2, 1.2, 1.6))),
}
FR1 = {
    "three-people": three_people, "box-put-down": box_put_down, "things": things,
    "box-sets-off": box_sets_off, "plain-sets-off": plain_sets_off,
}
# Scenes drawn from the seed: another seed makes sequences that nobody has seen.
DRAWN = {"fr1-drawn": None, "room-a-drawn": ROOM_A, "room-b-drawn": ROOM_B, "room-c-drawn": ROOM_C}
NAMES = [*FR1, "fast-empty", *ROOMS, *DRAWN]


def arguments(description: str, names: list[str]) -> argparse.ArgumentParser:
    """What all programs that make sequences are told."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("data", type=Path, help="folder of the recordings that are used")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}; default all")
    parser.add_argument("--out", type=Path, required=True, help="folder for the sequences")
    parser.add_argument("--seed", type=int, default=1, help="of everything that is drawn: motion, people, noise")
    parser.add_argument("--sheets", type=Path, help="folder for contact sheets")
    return parser


def parsed(parser: argparse.ArgumentParser, names: list[str]) -> argparse.Namespace:
    """The arguments; without names all are meant."""
    options = parser.parse_intermixed_args()
    if unknown := set(options.names) - set(names):
        parser.error(f"unknown: {', '.join(sorted(unknown))}")
    options.names = options.names or names
    return options


def main() -> None:
    options = parsed(arguments(__doc__.split("\n")[0], NAMES), NAMES)
    cv2.setNumThreads(1)
    for name in options.names:
        rng, folder = np.random.default_rng([options.seed, zlib.crc32(name.encode())]), options.out / name
        if name in FR1:
            writer = compose_fr1(options.data, folder, FR1[name](), rng)
        elif name == "fast-empty":
            writer = compose_fast(options.data, folder)
        elif name in DRAWN:
            room, scene = DRAWN[name], drawn(rng)
            writer = compose_room(options.data, folder, room, scene, rng) if room else compose_fr1(options.data, folder, scene, rng)
        else:
            room, scene = ROOMS[name]
            writer = compose_room(options.data, folder, room, scene(), rng)
        shares = [(cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0).mean() for path in sorted((folder / "mask").iterdir())]
        print(f"{name}: {len(shares)} frames, masked {100 * np.mean(shares):.1f} % on average, {100 * max(shares):.1f} % at most", flush=True)
        if options.sheets:
            save_sheet(writer, options.sheets / f"{name}.png")


if __name__ == "__main__":
    main()
