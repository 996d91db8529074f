"""Makes variants of sequences in TUM layout in another light: `off`, a lamp that goes off for a third of the frames and on again; `drift`, an
exposure that goes up and down by half; `shade`, a soft band with 30 % less brightness that passes over the image.

usage: relight_sequence.py SEQUENCE... --out DIR [--only VARIANT ...]
Each variant is a folder `SEQUENCE+VARIANT` with colour images of its own and links to everything else. Needs opencv-python-headless and
numpy.
"""

import argparse
import pathlib

import cv2
import numpy

# Brightness of grey levels while the lamp is off.
OFF = 0.45
# Share by which the exposure drifts, and frames in which it goes through one radian.
DRIFT, FRAMES_PER_RADIAN = 0.5, 6
# The band of shade: share of brightness that it takes, half of its width and its way per frame, pixels.
SHADE, HALF_WIDTH, STEP = 0.3, 70, 12


def off(image, index, count):
    return image * OFF if count // 3 <= index < 2 * count // 3 else image


def drift(image, index, _count):
    return image * (1 + DRIFT * numpy.sin(index / FRAMES_PER_RADIAN))


def shade(image, index, _count):
    width = image.shape[1]
    centre = index * STEP % (width + 2 * HALF_WIDTH) - HALF_WIDTH
    band = SHADE * numpy.exp(-(((numpy.arange(width) - centre) / HALF_WIDTH) ** 4))
    return image * (1 - band)[None, :, None]


VARIANTS = {"off": off, "drift": drift, "shade": shade}


def relight(sequence, light, folder):
    images = folder / "rgb"
    images.mkdir(parents=True, exist_ok=True)
    for entry in sequence.iterdir():
        link = folder / entry.name
        if entry.name != "rgb" and not link.is_symlink():
            link.symlink_to(entry.resolve())
    paths = sorted((sequence / "rgb").iterdir())
    for index, path in enumerate(paths):
        lit = light(cv2.imread(str(path)).astype(numpy.float32), index, len(paths))
        cv2.imwrite(str(images / path.name), numpy.clip(lit, 0, 255).astype(numpy.uint8))
    print(f"{folder}: {len(paths)} images")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="+", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--only", nargs="*", choices=VARIANTS, default=list(VARIANTS))
    arguments = parser.parse_args()
    for sequence in arguments.sequences:
        for name in arguments.only:
            relight(sequence, VARIANTS[name], arguments.out / f"{sequence.resolve().name}+{name}")


if __name__ == "__main__":
    main()
