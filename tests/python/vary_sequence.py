"""Makes variants of sequences in TUM layout that a camera could have recorded as well, to check results across more than one take.

usage: vary_sequence.py SEQUENCE... --out DIR [--only VARIANT ...] [--seed N]
Each variant is a folder `SEQUENCE+VARIANT` with lists of its own and links to the images and masks of the sequence. What plays backwards
gets new stamps; colour, depth and ground truth keep their distances in time. Where colour images come more than once, as in `fro`, each
time has a link of its own, named by its stamp, and so has its mask. No packages are needed.
"""

import argparse
import pathlib
import random

LISTS = ("rgb", "depth", "groundtruth")
SHARED = ("rgb", "depth", "mask", "calib.yaml")
# Seconds that depth and ground truth may reach beyond the first and last colour image, and between two passes of `fro`.
MARGIN, TURN = 0.02, 0.04
# Images that a gap of about a second leaves out.
GAP = 30


def read(path):
    rows = (line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#"))
    return [(float(row[0]), row[1:]) for row in rows]


def write(path, rows):
    path.write_text("".join(f"{stamp:.6f} {' '.join(rest)}\n" for stamp, rest in rows))


class Take:
    """The lists of a sequence, cut to the time of its colour images."""

    def __init__(self, folder):
        lists = {name: read(folder / f"{name}.txt") for name in LISTS if (folder / f"{name}.txt").exists()}
        self.start, self.end = lists["rgb"][0][0], lists["rgb"][-1][0]
        inside = lambda stamp: self.start - MARGIN <= stamp <= self.end + MARGIN
        self.lists = {name: [row for row in rows if inside(row[0])] for name, rows in lists.items()}

    def with_images(self, choose):
        return self.lists | {"rgb": choose(self.lists["rgb"])}

    def mapped(self, time, rows):
        return sorted((time(stamp), rest) for stamp, rest in rows)

    def backwards(self):
        time = lambda stamp: self.start + self.end - stamp
        return {name: self.mapped(time, rows) for name, rows in self.lists.items()}

    def to_and_fro(self):
        """Forwards, backwards, forwards."""
        period = self.end - self.start + TURN
        passes = (lambda t: t, lambda t: 2 * self.start + 2 * period - TURN - t, lambda t: t + 2 * period)
        return {name: distinct(row for time in passes for row in self.mapped(time, rows)) for name, rows in self.lists.items()}


def distinct(rows):
    """The rows in order of time, one for each stamp."""
    return sorted({round(stamp, 6): rest for stamp, rest in rows}.items())


def variants(take, rng):
    images = take.lists["rgb"]
    third = len(images) // 3
    gap = range(len(images) // 2 - GAP // 2, len(images) // 2 + GAP // 2)
    backwards = take.backwards()
    dropped = lambda share: take.with_images(lambda rows: [row for row in rows if rng.random() > share])
    return {
        "reversed": backwards,
        "late": take.with_images(lambda rows: rows[third:]),
        "late-reversed": backwards | {"rgb": backwards["rgb"][third:]},
        "half": take.with_images(lambda rows: rows[::2]),
        "third": take.with_images(lambda rows: rows[::3]),
        "quarter-reversed": backwards | {"rgb": backwards["rgb"][::4]},
        "drop30": dropped(0.3),
        "drop50": dropped(0.5),
        "gap": take.with_images(lambda rows: [row for i, row in enumerate(rows) if i not in gap]),
        "fro": take.to_and_fro(),
    }


def link(path, target):
    if target.exists() and not path.exists():
        path.symlink_to(target)


def with_own_names(folder, source, rows):
    """The rows of colour images with a name for each stamp, and the links with these names to images and masks."""
    for name in filter(lambda name: (source / name).exists(), ("rgb", "mask")):
        if (folder / name).is_symlink():
            (folder / name).unlink()
        (folder / name).mkdir(exist_ok=True)
    named = []
    for stamp, (file, *rest) in rows:
        image, name = source / file, f"{stamp:.6f}"
        link(folder / "rgb" / f"{name}{image.suffix}", image)
        link(folder / "mask" / f"{name}.png", source / "mask" / f"{image.stem}.png")
        named.append((stamp, [f"rgb/{name}{image.suffix}", *rest]))
    return named


def save(folder, source, lists):
    folder.mkdir(parents=True, exist_ok=True)
    files = [file for _, (file, *_) in lists["rgb"]]
    if len(set(files)) < len(files):
        lists = lists | {"rgb": with_own_names(folder, source, lists["rgb"])}
    for name, rows in lists.items():
        write(folder / f"{name}.txt", rows)
    for name in SHARED:
        link(folder / name, source / name)


def main():
    parser = argparse.ArgumentParser(usage=__doc__)
    parser.add_argument("sequences", nargs="+", type=pathlib.Path)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for sequence in map(pathlib.Path.resolve, arguments.sequences):
        for name, lists in variants(Take(sequence), random.Random(arguments.seed)).items():
            if not arguments.only or name in arguments.only:
                save(arguments.out / f"{sequence.name}+{name}", sequence, lists)


if __name__ == "__main__":
    main()
