"""Renders rooms with people, seen by cameras that move as those of recorded sequences did.

usage: render_rooms.py DATA --out DIR [NAME ...] [--seed N] [--frames N] [--readout S]
           [--size WxH --focal F --rate HZ --stereo] [--sheets DIR]        (pip install numpy opencv-python open3d)
DATA holds `tum-fr3-dynamic-text` (camera paths), and `tum-fr1-xyz-first180`, `joint-vo-sf-pairs` and
`tum-fr3-walking-halfsphere-rgb10`, whose images become posters, book covers and screens. Each sequence gets `rgb/`, `depth/`, `mask/`,
their lists, `groundtruth.txt` and `calib.yaml` in TUM layout.

Room, furniture, people, their ways and the part of the camera path are drawn from the seed. Two people walk to and fro behind and before a
desk and pause, or sit at it, sway and gesture. Colour: two lamps, shadows of people, motion blur of 12 ms, noise, exposure that drifts, and
a rolling shutter if `--readout` says so. Depth: up to 8 ms beside the colour image; disparity steps and noise, ragged outlines, the
projector's shadow, holes at edges, grazing angles and on dark surfaces; with `--stereo` as an active stereo camera has it, with fattened
outlines. Mask: 255 = somebody who walks or sits and sways, 128 = a walker who stands still, 0 = static.
"""

import argparse
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import open3d

import compose_movers as movers
from compose_movers import MOVING, STATIC, Looks, Path3, Scene, Solid, Texture, Track, Writer, box, limb, person, yaw

PAUSED = 128
# Slower than this, metres a second, a walker stands still.
STILL = 0.02
# freiburg3, without distortion: fx, fy, cx, cy.
FREIBURG3 = [535.4, 539.2, 320.1, 247.6]
# Images of which the mean is taken, at moments spread over the exposure and at places within the pixel.
EXPOSURE, JITTER = 0.012, [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]
LAMPS = [np.array([-1.2, 0.6, 2.6]), np.array([1.5, 2.2, 2.6])]
AMBIENT, LAMP, SHADE = 0.4, 0.75, 0.22
# Depth stamps are off by up to this, seconds.
DEPTH_OFFSET = 0.008
# Farthest depth, widest shadow (pixels), cosine of the most grazing angle, and the grey level below which surfaces return little light.
FARTHEST, SHADOW, GRAZING, DARK = 6.5, 24, 0.12, 22
# Baseline of a stereo camera (metres), its disparity noise and steps per pixel, and its range.
STEREO_BASELINE, STEREO_NOISE, STEREO_STEPS, STEREO_RANGE = 0.05, 0.12, 32, (0.25, 8.0)

# ---------------------------------------------------------------- rooms, in ground coordinates: right, forward, up


@dataclass
class Photo:
    """Part of a real image on the faces of a solid, `scale` pixels a metre, mirrored where it ends."""

    image: np.ndarray
    scale: float
    tint: np.float32

    def on_faces(self, p: np.ndarray, normal: np.ndarray) -> np.ndarray:
        axis = np.abs(normal).argmax(1)
        u = np.where(axis == 0, p[:, 1], p[:, 0]) + 3.1 * axis
        v = np.where(axis == 2, p[:, 1], -p[:, 2]) + 1.7 * axis
        h, w = self.image.shape[:2]
        x, y = (np.abs((c * self.scale + 10 * n) % (2 * n) - n).clip(0, n - 1.001) for c, n in ((u, w), (v, h)))
        i, j = y.astype(int), x.astype(int)
        a, b = (x - j)[:, None].astype(np.float32), (y - i)[:, None].astype(np.float32)
        below, right = np.minimum(i + 1, h - 1), np.minimum(j + 1, w - 1)
        top = self.image[i, j] * (1 - a) + self.image[i, right] * a
        low = self.image[below, j] * (1 - a) + self.image[below, right] * a
        return (top * (1 - b) + low * b) * self.tint


class Room:
    """Four walls, desks, shelves and boxes."""

    def __init__(self, photos: list[np.ndarray], rng: np.random.Generator):
        self.photos, self.rng, self.solids = photos, rng, []
        self.width, self.back, self.front, self.height = rng.uniform(4.5, 6.5), -1.8, rng.uniform(3.6, 5.0), 2.7
        self.add_walls()
        self.add_posters()
        self.add_desk(rng.uniform(-0.4, 0.4), rng.uniform(1.5, 1.9), rng.uniform(-0.2, 0.2), rng.uniform(1.5, 1.9), 0.8)
        self.add_desk(rng.choice([-1, 1]) * rng.uniform(1.4, 1.7), rng.uniform(2.2, 2.8), rng.uniform(-0.5, 0.5), 1.4, 0.7)
        for side in (-1, 1):
            self.add_shelf(side)
        for _ in range(4):
            x, y = rng.choice([-1, 1]) * rng.uniform(1.0, 2.2), rng.uniform(0.8, 3.2)
            size = rng.uniform((0.25, 0.25, 0.2), (0.5, 0.5, 0.7))
            self.add(size, (x, y, size[2] / 2), rng.uniform(0, 3), self.photo((300, 600)) if rng.random() < 0.5 else self.mottled(0.45, 0.05))

    def add(self, size: tuple, centre: tuple, turn: float, texture: Texture | Photo) -> None:
        self.solids.append(box(tuple(size), centre, yaw(turn), texture, STATIC))

    def photo(self, scale: tuple = (350, 700), tint: float = 1.0) -> Photo:
        image = self.photos[self.rng.integers(len(self.photos))]
        h, w = image.shape[:2]
        y, x = self.rng.integers(0, h // 3), self.rng.integers(0, w // 3)
        return Photo(image[y : y + 2 * h // 3, x : x + 2 * w // 3], self.rng.uniform(*scale), np.float32(tint))

    def plain(self, level: float) -> Texture:
        colour = tuple(level * self.rng.uniform(0.9, 1.1, 3))
        return Texture("flat", colour, tuple(np.minimum(1, np.array(colour) * 1.96)), 0.3)

    def mottled(self, level: float, scale: float) -> Texture:
        return Texture("noise", tuple(level * self.rng.uniform(0.85, 1.1, 3)), tuple(level * self.rng.uniform(1.1, 1.4, 3)), scale)

    def add_walls(self) -> None:
        thick, middle = 0.1, (self.front + self.back) / 2
        w, depth, h = self.width, self.front - self.back, self.height
        self.add((w, depth, thick), (0, middle, -thick / 2), 0, self.mottled(0.35, 0.03))
        self.add((w, depth, thick), (0, middle, h + thick / 2), 0, self.plain(0.75))
        for x in (-1, 1):
            self.add((thick, depth, h), (x * (w / 2 + thick / 2), middle, h / 2), 0, self.plain(0.65))
        self.add((w, thick, h), (0, self.front + thick / 2, h / 2), 0, self.plain(0.62))
        self.add((w, thick, h), (0, self.back - thick / 2, h / 2), 0, self.plain(0.62))

    def add_posters(self) -> None:
        rng, flat = self.rng, 0.01
        for _ in range(6):
            x, z = rng.uniform(-self.width / 2 + 0.5, self.width / 2 - 0.5), rng.uniform(1.0, 2.0)
            self.add((rng.uniform(0.4, 1.0), flat, rng.uniform(0.3, 0.8)), (x, self.front - flat / 2, z), 0, self.photo())
        for side in (-1, 1):
            for _ in range(3):
                size = (flat, rng.uniform(0.4, 1.0), rng.uniform(0.3, 0.8))
                self.add(size, (side * (self.width / 2 - flat / 2), rng.uniform(0.3, self.front - 0.5), rng.uniform(1, 1.9)), 0, self.photo())

    def add_desk(self, x: float, y: float, turn: float, w: float, d: float) -> None:
        rng = self.rng
        at = lambda right, forward, up: np.array([x, y, 0]) + yaw(turn) @ np.array([right, forward, up])
        self.add((w, d, 0.03), at(0, 0, 0.72), turn, self.mottled(0.55, 0.02) if rng.random() < 0.5 else self.plain(0.6))
        for i in (-1, 1):
            for j in (-1, 1):
                self.add((0.05, 0.05, 0.71), at(i * (w / 2 - 0.05), j * (d / 2 - 0.05), 0.355), turn, self.plain(0.25))
        for _ in range(rng.integers(1, 3)):
            right = rng.uniform(-w / 2 + 0.3, w / 2 - 0.3)
            k = turn + rng.uniform(-0.3, 0.3)
            self.add((0.48, 0.05, 0.32), at(right, 0.12, 0.98), k, self.plain(0.07))
            self.add((0.44, 0.002, 0.28), at(right, 0.12, 0.98) + yaw(k) @ np.array([0, -0.027, 0]), k, self.photo((700, 1000), 0.8))
            self.add((0.06, 0.06, 0.12), at(right, 0.15, 0.79), k, self.plain(0.1))
            self.add((0.22, 0.18, 0.02), at(right, 0.14, 0.745), k, self.plain(0.1))
        for _ in range(rng.integers(4, 9)):
            size = rng.uniform((0.05, 0.05, 0.02), (0.32, 0.26, 0.22))
            place = at(rng.uniform(-w / 2 + 0.15, w / 2 - 0.15), rng.uniform(-d / 2 + 0.1, 0), 0.735 + size[2] / 2)
            angle = rng.uniform(0, 6)
            self.add(size, place, angle, self.photo((600, 1200)) if rng.random() < 0.7 else self.plain(rng.uniform(0.1, 0.8)))

    def add_shelf(self, side: int) -> None:
        rng, y = self.rng, self.front - 0.16
        x, h = side * rng.uniform(0.7, self.width / 2 - 0.6), rng.uniform(1.2, 2.1)
        w = rng.uniform(0.7, 1.0)
        self.add((w, 0.3, 0.02), (x, y, h), 0, self.plain(0.5))
        for i in (-1, 1):
            self.add((0.02, 0.3, h), (x + i * w / 2, y, h / 2), 0, self.plain(0.5))
        for level in np.arange(0.05, h - 0.3, 0.36):
            self.add((w, 0.3, 0.02), (x, y, level), 0, self.plain(0.5))
            p = -w / 2 + 0.05
            while p < w / 2 - 0.08:
                thick = rng.uniform(0.02, 0.07)
                if rng.random() < 0.8:
                    size = (thick, 0.2, rng.uniform(0.18, 0.3))
                    cover = self.photo((900, 1500)) if rng.random() < 0.5 else Texture("flat", tuple(rng.uniform(0.05, 0.8, 3)))
                    self.add(size, (x + p + thick / 2, y, level + 0.13), 0, cover)
                p += thick + 0.004


# ---------------------------------------------------------------- people


def drawn_looks(rng: np.random.Generator) -> Looks:
    colour = lambda low=0.08, high=0.85: tuple(rng.uniform(low, high, 3))
    kind = rng.choice(["checks", "stripes", "noise", "flat"])
    shirt = Texture(kind, colour(), colour(), rng.uniform(0.03, 0.1)) if kind != "flat" else Texture("flat", colour(), (0.2, 0.2, 0.2), 0.2)
    trousers = lambda: Texture(rng.choice(["flat", "noise"]), colour(0.08, 0.5), colour(0.08, 0.5), 0.05)
    return Looks(rng.uniform(1.6, 1.9), shirt, trousers(), colour(0.05, 0.2))


def walkers(rng: np.random.Generator, seconds: float) -> tuple[Scene, list[Solid]]:
    """Two who go from place to place beside and behind the desk, now and then before it, and pause in one case of three."""
    who = []
    for _ in range(2):
        t, points = -rng.uniform(0, 2), []
        here = np.array([rng.uniform(-1.6, 1.6), rng.uniform(1.0, 3.0)])
        while t < seconds + 6:
            points.append((t, *here))
            if rng.random() < 0.35:
                t += rng.uniform(0.5, 1.5)
                points.append((t, *here))
            there = np.array([rng.uniform(-1.8, 1.8), rng.uniform(0.9, 1.2) if rng.random() < 0.5 else rng.uniform(2.3, 3.1)])
            t += np.linalg.norm(there - here) / rng.uniform(0.6, 1.2) + 0.3
            here = there
        who.append((Track(*points), drawn_looks(rng)))
    label = lambda track, t: MOVING if track.at(t)[3] > STILL else PAUSED
    return lambda t: [part for track, looks in who for part in movers.labelled(person(track, looks, t), label(track, t))], []


def seated(place: tuple, heading: float, looks: Looks, t: float, phase: float, rates: np.ndarray) -> list[Solid]:
    """Somebody who sits, turns, leans and nods a little and now and then moves a hand; `rates` in radians a second."""
    frame = yaw(heading + 0.12 * np.sin(rates[0] * t + phase))
    lean, floor = 0.04 * np.sin(rates[1] * t + phase), np.array([*place, -0.45])
    point = lambda x, y, z: floor + frame @ np.array([x + lean * max(0, z - 0.95) * 2, y, z])
    side, skin = frame[:, 1], Texture("flat", looks.skin)
    hair = Texture("noise", looks.hair, tuple(2 * c for c in looks.hair), 0.02)
    solid = lambda size, at, texture, turned=frame: Solid("ellipsoid", np.array(size), turned, at, texture)
    parts = [
        limb(point(0, 0, 0.98), point(0, 0, 1.33), 0.135, side, looks.shirt),
        solid([0.13, 0.205, 0.19], point(0, 0, 1.3), looks.shirt),
        solid([0.135, 0.18, 0.16], point(0, 0, 0.95), looks.trousers),
        limb(point(0, 0, 1.42), point(0.02, 0, 1.55), 0.055, side, skin),
        solid([0.1, 0.078, 0.12], point(0.02, 0, 1.635), skin, frame @ yaw(0.35 * np.sin(rates[2] * t))),
        solid([0.1, 0.086, 0.1], point(0, 0, 1.67), hair),
    ]
    for left in (-1, 1):
        hip, knee, ankle = (0, left * 0.1, 0.9), (0.42, left * 0.13, 0.93), (0.44, left * 0.13, 0.5)
        parts += [limb(point(*hip), point(*knee), 0.08, side, looks.trousers), limb(point(*knee), point(*ankle), 0.058, side, looks.trousers)]
        a = 0.15 * np.sin(rates[3] * t + left) * max(0, np.sin(0.35 * t + phase + left))
        shoulder, elbow = point(0, left * 0.21, 1.42), point(0.12, left * 0.27, 1.17)
        hand = point(0.36 + a, left * 0.15, 1.2 + 1.2 * a)
        parts += [limb(shoulder, elbow, 0.052, side, looks.shirt), limb(elbow, hand, 0.042, side, looks.shirt), solid([0.05, 0.04, 0.055], hand, skin)]
    return parts


def chair(place: tuple, heading: float) -> list[Solid]:
    black, frame = Texture("flat", (0.1, 0.1, 0.12)), yaw(heading)
    back = np.array([*place, 0.7]) + frame @ np.array([-0.2, 0, 0])
    return [box((0.42, 0.42, 0.06), np.array([*place, 0.4]), frame, black, STATIC), box((0.05, 0.42, 0.5), back, frame, black, STATIC)]


def sitters(rng: np.random.Generator, _seconds: float) -> tuple[Scene, list[Solid]]:
    """Two who sit at the desk, and their chairs."""
    who, chairs = [], []
    for side in (-1, 1):
        place = (side * rng.uniform(0.45, 0.75), rng.uniform(1.25, 2.1))
        heading, looks = np.pi / 2 - side * rng.uniform(-0.6, 1.8), drawn_looks(rng)
        rates = rng.uniform((0.5, 0.6, 0.8, 2), (1.5, 1.8, 2.0, 5))
        who.append((place, heading, looks, rng.uniform(0, 6), rates))
        chairs += chair(place, heading)
    return lambda t: [part for place, heading, looks, phase, rates in who for part in seated(place, heading, looks, t, phase, rates)], chairs


# ---------------------------------------------------------------- rays


def sphere(rings: int = 12, around: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles."""
    polar, turn = np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, around, endpoint=False)
    corners = np.array([[np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)] for a in polar for b in turn], np.float32)
    corner = lambda i, j: i * around + j % around
    quads = ((corner(i, j), corner(i, j + 1), corner(i + 1, j), corner(i + 1, j + 1)) for i in range(rings) for j in range(around))
    return corners, np.array([t for a, b, c, d in quads for t in ([a, c, b], [b, c, d])], np.uint32)


SPHERE = sphere()
CUBE = (
    np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32),
    np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.uint32),
)


def mesh(solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Corners in the world and triangles."""
    corners, triangles = CUBE if solid.kind == "box" else SPHERE
    if solid.kind == "capsule":
        ends = np.where(corners[:, 2] > 1e-6, 1, -1) * solid.size[2]
        corners = corners * solid.size[0] + np.array([0, 0, 1]) * ends[:, None]
    else:
        corners = corners * solid.size
    return np.ascontiguousarray(corners @ solid.rotation.T + solid.centre, np.float32), triangles


@dataclass
class Hits:
    """Where rays hit: distances (inf = nowhere), index of the solid and normal of the triangle."""

    distance: np.ndarray
    solid: np.ndarray
    normal: np.ndarray


class Caster:
    """Solids that rays can hit."""

    def __init__(self, solids: list[Solid]):
        self.solids, self.scene = solids, open3d.t.geometry.RaycastingScene()
        for solid in solids:
            self.scene.add_triangles(*map(open3d.core.Tensor, mesh(solid)))

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        both = np.ascontiguousarray(np.concatenate([origins, directions], 1), np.float32)
        hits = self.scene.cast_rays(open3d.core.Tensor(both))
        return Hits(*(hits[key].numpy() for key in ("t_hit", "geometry_ids", "primitive_normals")))

    def shade(self, hits: Hits, chosen: np.ndarray, origins: np.ndarray, directions: np.ndarray, tint: np.ndarray) -> np.ndarray:
        """Colour 0..255 of the `chosen` rays, which all hit something."""
        t, ids, o, d, triangle = (a[chosen] for a in (hits.distance, hits.solid, origins, directions, hits.normal))
        out = np.zeros((len(t), 3), np.float32)
        order = np.argsort(ids, kind="stable")
        bounds = np.searchsorted(ids[order], np.arange(len(self.solids) + 1))
        for k, solid in enumerate(self.solids):
            i = order[bounds[k] : bounds[k + 1]]
            if len(i):
                place = o[i] + t[i, None] * d[i]
                out[i] = 255 * lit(solid, place, d[i], triangle[i])
        return out * tint


def lit(solid: Solid, place: np.ndarray, direction: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Colour 0..1 of points on a solid under the lamps."""
    p, n = (place - solid.centre) @ solid.rotation, triangle @ solid.rotation
    if solid.kind == "ellipsoid":
        n = p / solid.size**2
    elif solid.kind == "capsule":
        n = p - np.stack([0 * p[:, 0], 0 * p[:, 0], np.clip(p[:, 2], -solid.size[2], solid.size[2])], 1)
    n = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
    outwards = n @ solid.rotation.T
    outwards = np.where((outwards * direction).sum(1, keepdims=True) > 0, -outwards, outwards)
    light = AMBIENT * np.ones(len(place))
    for lamp in LAMPS:
        to = lamp - place
        distance = np.linalg.norm(to, axis=1)
        light += LAMP * np.maximum((outwards * to).sum(1) / distance, 0) / (0.6 + 0.25 * distance**2)
    photo = isinstance(solid.texture, Photo)
    return (solid.texture.on_faces(p, n) if photo else solid.texture.colour(p.astype(np.float32))) * light[:, None]


# ---------------------------------------------------------------- cameras


@dataclass
class View:
    """Camera on its path in ground coordinates: columns, rows, fx, fy, cx, cy; the path in the world, axes and origin of the ground."""

    size: tuple
    intrinsics: list
    path: Path3
    axes: np.ndarray
    origin: np.ndarray

    def rays(self, stamps: np.ndarray, offset: tuple = (0, 0)) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (z = 1 in the camera) of the rays of all pixels, row by row; one stamp for all rows, or one each."""
        (width, height), (fx, fy, cx, cy) = self.size, self.intrinsics
        v, u = np.mgrid[0:height, 0:width]
        local = np.stack([(u + offset[0] - cx) / fx, (v + offset[1] - cy) / fy, np.ones(u.shape)], 2).reshape(len(stamps), -1, 3)
        origins, directions = np.empty_like(local), np.empty_like(local)
        for k, stamp in enumerate(stamps):
            rotation, place = self.path.pose(stamp)
            directions[k] = local[k] @ (self.axes.T @ rotation).T
            origins[k] = self.axes.T @ (place - self.origin)
        return origins.reshape(-1, 3), directions.reshape(-1, 3)


def look_out(path: Path3, start: float, seconds: float, size: tuple, intrinsics: list) -> View:
    """The ground lies below the middle of that part of the path; forward is where the camera looks on average."""
    poses = [path.pose(start + t) for t in np.linspace(0, seconds, 20)]
    forward = np.mean([rotation[:, 2] for rotation, _ in poses], 0) * [1, 1, 0]
    forward /= np.linalg.norm(forward)
    axes = np.stack([np.cross(forward, [0, 0, 1]), forward, [0, 0, 1]], 1)
    return View(size, intrinsics, path, axes, np.mean([place for _, place in poses], 0) * [1, 1, 0])


def shadows(people: Caster, places: np.ndarray, size: tuple) -> np.ndarray:
    """How much of the light arrives, one number a pixel."""
    width, height = size
    half = np.arange(len(places)).reshape(height, width)[::2, ::2].ravel()
    light = np.ones((height // 2, width // 2), np.float32)
    for lamp in LAMPS:
        to = lamp - places[half]
        light -= SHADE * (people.cast(places[half] + 0.03 * to, to).distance < 0.97).reshape(light.shape)
    return cv2.GaussianBlur(cv2.resize(light, size), (0, 0), 2.5).reshape(-1, 1)


def colour_image(view: View, room: Caster, people: Caster, rows: np.ndarray, exposure: float, rng: np.random.Generator) -> np.ndarray:
    """`rows` are the stamps at which the middle of the exposure of each row falls."""
    width, height = view.size
    total, tint = np.zeros((height * width, 3), np.float32), np.float32([0.95, 1, 1.03]) * exposure
    light = None
    for k, offset in enumerate(JITTER):
        origins, directions = view.rays(rows + (k / (len(JITTER) - 1) - 0.5) * EXPOSURE, offset)
        behind, before = room.cast(origins, directions), people.cast(origins, directions)
        front = before.distance < behind.distance
        back = ~front & np.isfinite(behind.distance)
        colour = np.zeros((len(front), 3), np.float32)
        colour[back] = room.shade(behind, back, origins, directions, tint)
        colour[front] = people.shade(before, front, origins, directions, tint)
        if light is None:
            nearest = np.minimum(behind.distance, before.distance)
            light = shadows(people, origins + np.where(np.isfinite(nearest), nearest, 0)[:, None] * directions, view.size)
        total += np.where(front[:, None], colour, colour * light)
    v, u = np.mgrid[0:height, 0:width]
    vignette = 1 - 0.18 * (((u - width / 2) / (0.625 * width)) ** 2 + ((v - height / 2) / (0.625 * width)) ** 2)
    image = (total / len(JITTER)).reshape(height, width, 3) * vignette[..., None]
    noisy = image + (1.0 + 0.12 * np.sqrt(np.maximum(image, 0))) * rng.standard_normal(image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def blotches(shape: tuple, sigma: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of variance one that is alike within about `sigma` pixels."""
    noise = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), sigma)
    return noise / noise.std()


def depth_image(z: np.ndarray, cosine: np.ndarray, gray: np.ndarray, stereo: float | None, rng: np.random.Generator) -> np.ndarray:
    """Depth as the sensor sees it, 0 = none: true depth, cosine of the viewing angle, grey levels; focal length of a stereo camera."""
    v, u = np.mgrid[0 : z.shape[0], 0 : z.shape[1]].astype(np.float32)
    x, y = (np.float32(0.8 * blotches(z.shape, 1.5, rng)) for _ in range(2))
    ragged = cv2.remap(np.float32(z), u + x, v + y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    if stereo is None:
        out = movers.sensed(np.where(ragged < FARTHEST, ragged, np.inf), rng)
    else:
        fat, scale = cv2.erode(np.float32(ragged), np.ones((5, 5))), stereo * STEREO_BASELINE
        disparity = scale / np.maximum(fat, 0.2) + STEREO_NOISE * blotches(z.shape, 2.0, rng)
        measured = scale / np.maximum(np.round(disparity * STEREO_STEPS) / STEREO_STEPS, 0.5)
        out = np.where((fat > STEREO_RANGE[0]) & (fat < STEREO_RANGE[1]), measured, 0)
    disparity, hidden = movers.FOCAL_BASELINE / np.maximum(ragged, 0.3), np.zeros(z.shape, bool)
    for w in range(1, SHADOW + 1):
        hidden[:, :-w] |= disparity[:, w:] - disparity[:, :-w] >= w
    out[hidden] = 0
    inverse, square = np.float32(1 / ragged), np.ones((3, 3))
    out[(cv2.dilate(inverse, square) - cv2.erode(inverse, square) > 0.04) & (rng.random(z.shape) < 0.4)] = 0
    out[cosine < GRAZING] = 0
    out[(gray < DARK) & (blotches(z.shape, 2.5, rng) > -0.3)] = 0
    return out


# ---------------------------------------------------------------- sequences

PEOPLE = {"walking": walkers, "sitting": sitters}
PATHS = {"rpy": "rpy", "half": "halfsphere", "xyz": "xyz", "static": "static"}
NAMES = [f"{who}-{path}" for who in PEOPLE for path in PATHS]


def photos_of(data: Path) -> list[np.ndarray]:
    files = sorted((data / "tum-fr1-xyz-first180/rgb").glob("*"))[::30]
    files += sorted((data / "joint-vo-sf-pairs").glob("*/rgb/0.png"))
    files += sorted((data / "tum-fr3-walking-halfsphere-rgb10/rgb").glob("*"))[::3]
    return [cv2.GaussianBlur(cv2.imread(str(file)), (0, 0), 0.6).astype(np.float32) / 255 for file in files]


def recorded(data: Path, who: str, path: str) -> Path:
    """Ground truth of the sequence of that name, or of the walking one where there is none."""
    file = lambda who: data / f"tum-fr3-dynamic-text/groundtruth/fr3_{who}_{PATHS[path]}.txt"
    return file(who) if file(who).exists() else file("walking")


def write(options: argparse.Namespace, folder: Path, people: Callable, source: Path, rng: np.random.Generator) -> Writer:
    (width, height), focal = options.size, options.focal
    intrinsics = [focal, focal, width / 2 - 0.5, height / 2 - 0.5] if focal else FREIBURG3
    path = Path3(np.loadtxt(source))
    seconds = options.frames / options.rate
    start = rng.uniform(path.rows[0, 0] + 0.5, path.rows[-1, 0] - seconds - 0.5)
    view = look_out(path, start, seconds, (width, height), intrinsics)
    scene, furniture = people(rng, seconds)
    room = Caster(Room(photos_of(options.data), rng).solids + furniture)
    writer = Writer(folder, [*intrinsics, 0, 0, 0, 0, 0], f"rendered room, camera path of {source.stem}", (width, height))
    rows = (np.arange(height) / height - 0.5) * options.readout
    for i in range(options.frames):
        t = i / options.rate
        stamp = start + t
        exposure = 1 + 0.06 * np.sin(0.8 * t + 1) + 0.02 * np.sin(2.9 * t)
        here = Caster(scene(t))
        image = colour_image(view, room, here, stamp + rows, exposure, rng)
        mask = mask_image(view, room, here, stamp + rows)
        late = rng.uniform(-DEPTH_OFFSET, DEPTH_OFFSET)
        z, cosine = true_depth(view, room, Caster(scene(t + late)), stamp + late)
        gray = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (0, 0), 2)
        depth = depth_image(z, cosine, gray, intrinsics[0] if options.stereo else None, rng)
        writer.image("rgb", stamp, image)
        writer.image("mask", stamp, mask)
        writer.depth(stamp + late, depth)
        if i % max(1, options.frames // 20) == 0:
            movers.note_sheet(writer, image, mask, depth)
    near = (path.rows[:, 0] > start - 1) & (path.rows[:, 0] < start + seconds + 1)
    on_ground = lambda row: np.r_[view.axes.T @ (row[1:4] - view.origin), movers.quaternion(view.axes.T @ movers.matrix(row[4:]))]
    writer.close([(row[0], on_ground(row)) for row in path.rows[near]])
    return writer


def mask_image(view: View, room: Caster, people: Caster, rows: np.ndarray) -> np.ndarray:
    rays, labels = view.rays(rows), np.array([part.label for part in people.solids], np.uint8)
    behind, before = room.cast(*rays), people.cast(*rays)
    label = labels[np.minimum(before.solid, len(labels) - 1)]
    return np.where(before.distance < behind.distance, label, STATIC).astype(np.uint8).reshape(view.size[::-1])


def true_depth(view: View, room: Caster, people: Caster, stamp: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth, and the cosine of the angle between surface normal and ray."""
    origins, directions = view.rays(np.array([stamp]))
    behind, before = room.cast(origins, directions), people.cast(origins, directions)
    normal = np.where((before.distance < behind.distance)[:, None], before.normal, behind.normal)
    cosine = np.abs((normal * directions).sum(1) / np.linalg.norm(directions, axis=1))
    return tuple(a.reshape(view.size[::-1]) for a in (np.minimum(behind.distance, before.distance), cosine))


def main() -> None:
    parser = movers.arguments(__doc__.split("\n")[0], NAMES)
    parser.add_argument("--frames", type=int, default=210)
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    parser.add_argument("--readout", type=float, default=0.0, help="seconds from the first row to the last")
    parser.add_argument("--size", type=lambda text: tuple(map(int, text.split("x"))), default=(640, 480), help="columns x rows")
    parser.add_argument("--focal", type=float, help="focal length, pixels, with the principal point in the middle; default that of freiburg3")
    parser.add_argument("--stereo", action="store_true", help="depth of an active stereo camera")
    options = movers.parsed(parser, NAMES)
    cv2.setNumThreads(1)
    for name in options.names:
        rng, (who, path) = np.random.default_rng([options.seed, zlib.crc32(name.encode())]), name.split("-")
        writer = write(options, options.out / f"{name}-{options.seed}", PEOPLE[who], recorded(options.data, who, path), rng)
        print(f"{name}-{options.seed}: {options.frames} frames", flush=True)
        if options.sheets:
            movers.save_sheet(writer, options.sheets / f"{name}-{options.seed}.png")


if __name__ == "__main__":
    main()
