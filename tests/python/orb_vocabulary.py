"""Trains a bag-of-words vocabulary for ORB-SLAM3 where its own (ORBvoc.txt) cannot be downloaded.

usage: orb_vocabulary.py VOCABULARY.txt SEQUENCE...
Needs numpy and OpenCV (pip install opencv-python-headless). Clusters the ORB descriptors of the sequences' colour images into a
tree of 10 branches and 4 levels (k-medians in Hamming distance) and writes DBoW2's text form. A smaller tree than the original,
enough for sequences of a few hundred frames.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

BRANCHES = 10
LEVELS = 4
IMAGES = 120
FEATURES = 1000
ITERATIONS = 8
SEED = 0
# Numbers of DBoW2: L1 score, weights by term and inverse document frequency.
L1_NORM, TF_IDF = 0, 0


def image_paths(sequences):
    """Images spread evenly over all sequences."""
    paths = []
    for sequence in map(Path, sequences):
        lines = (sequence / "rgb.txt").read_text().splitlines()
        paths += [sequence / line.split()[1] for line in lines if line and not line.startswith("#")]
    return paths[:: max(1, len(paths) // IMAGES)]


def describe(paths):
    """Bits (n × 256, as ±1) of all descriptors, and the number of the image that each comes from."""
    orb = cv2.ORB_create(FEATURES)
    descriptors, images = [], []
    for number, path in enumerate(paths):
        found = orb.detectAndCompute(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), None)[1]
        if found is not None:
            descriptors.append(found)
            images.append(np.full(len(found), number))
    bits = np.unpackbits(np.concatenate(descriptors), axis=1).astype(np.float32) * 2 - 1
    return bits, np.concatenate(images)


def cluster(bits, rng):
    """The number of the cluster of each row."""
    centres = bits[rng.choice(len(bits), BRANCHES, replace=False)]
    for _ in range(ITERATIONS):
        nearest = np.argmax(bits @ centres.T, axis=1)
        for k in np.unique(nearest):
            centres[k] = np.where(bits[nearest == k].sum(axis=0) >= 0, 1, -1)
    return np.argmax(bits @ centres.T, axis=1)


def centre(bits):
    return np.packbits(bits.sum(axis=0) >= 0)


class Tree:
    """Nodes in the order of their numbers; 0 is the root, which is not written."""

    def __init__(self, bits, images):
        self.bits, self.images = bits, images
        self.total = len(np.unique(images))
        self.lines = []
        self.rng = np.random.default_rng(SEED)

    def grow(self, parent, members, level):
        groups = cluster(self.bits[members], self.rng)
        for k in np.unique(groups):
            child = members[groups == k]
            is_leaf = level == LEVELS or len(child) <= BRANCHES
            weight = np.log(self.total / len(np.unique(self.images[child]))) if is_leaf else 0.0
            descriptor = " ".join(map(str, centre(self.bits[child])))
            self.lines.append(f"{parent} {int(is_leaf)} {descriptor} {weight:.6f}")
            if not is_leaf:
                self.grow(len(self.lines), child, level + 1)


def main():
    target, *sequences = sys.argv[1:]
    bits, images = describe(image_paths(sequences))
    tree = Tree(bits, images)
    tree.grow(0, np.arange(len(bits)), 1)
    Path(target).write_text("\n".join([f"{BRANCHES} {LEVELS} {L1_NORM} {TF_IDF}", *tree.lines]) + "\n")
    words = sum(line.split()[1] == "1" for line in tree.lines)
    print(f"{target}: {words} words from {len(bits)} descriptors", file=sys.stderr)


main()
