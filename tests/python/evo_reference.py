"""Prints as JSON what evo makes of a ground truth and an estimate: the oracle of tests/tests/evaluator.rs.

usage: evo_reference.py GROUNDTRUTH ESTIMATE [FRAMES_PER_SECOND]
With FRAMES_PER_SECOND also the relative error over that many frames, all pairs.
"""

import json
import sys

from evo.core import metrics, sync
from evo.tools import file_interface

MAX_DIFFERENCE = 0.02


def statistics(metric, data):
    metric.process_data(data)
    return metric.get_all_statistics() | {"pairs": len(metric.error)}


def relative(relation, frames, data):
    return statistics(metrics.RPE(relation, frames, metrics.Unit.frames, all_pairs=True), data)


def main():
    ground_truth, estimate = map(file_interface.read_tum_trajectory_file, sys.argv[1:3])
    pairs = sync.associate_trajectories(ground_truth, estimate, max_diff=MAX_DIFFERENCE)
    pairs[1].align(pairs[0])
    result = {"ate": statistics(metrics.APE(metrics.PoseRelation.translation_part), pairs)}
    if len(sys.argv) > 3:
        frames = int(sys.argv[3])
        result["rpe_translation"] = relative(metrics.PoseRelation.translation_part, frames, pairs)
        result["rpe_rotation_deg"] = relative(metrics.PoseRelation.rotation_angle_deg, frames, pairs)
    json.dump(result, sys.stdout)


main()
