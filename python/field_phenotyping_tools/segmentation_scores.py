"""Agreement of the part and plant given to every point with the truth."""

import numpy as np
from scipy.spatial import cKDTree

NO_PART, STEM, OTHER_ORGAN = 0, 1, 2
BOUNDARY = 0.01  # [m] a point this near to one of the other true class is on the boundary


def score_stem_class(positions, truth_part, predicted_part, scored=None):
    """SA, F1, IoU and BP of the stem class.

    positions (n, 3) [m], truth_part and predicted_part (n,). `scored` (n,) bool leaves points out
    of F1 and IoU; by default every point counts, so that a stem claimed on the ground is an error.
    SA and BP are taken over the points that are truly stem or organ. A score that is not defined is
    NaN.
    """
    if scored is None:
        scored = np.ones(len(truth_part), bool)
    true_stem, stem = truth_part == STEM, predicted_part == STEM
    plant = truth_part != NO_PART
    hits = int(np.sum(scored & true_stem & stem))
    false = int(np.sum(scored & ~true_stem & stem))
    missed = int(np.sum(scored & true_stem & ~stem))
    boundary = boundary_points(positions, truth_part)
    return {
        'sa': _ratio(np.sum(plant & (true_stem == stem)), np.sum(plant)),
        'stem_precision': _ratio(hits, hits + false),
        'stem_recall': _ratio(hits, hits + missed),
        'stem_f1': _ratio(2 * hits, 2 * hits + false + missed),
        'stem_iou': _ratio(hits, hits + false + missed),
        'bp': _ratio(np.sum(boundary & true_stem & stem), np.sum(boundary & stem)),
        'boundary_points': int(np.sum(boundary)),
        'stem_on_ground_points': int(np.sum(scored & (truth_part == NO_PART) & stem)),
    }


def boundary_points(positions, truth_part, distance=BOUNDARY):
    """Mask of stem and organ points within `distance` [m] of one of the other true class."""
    finite = np.all(np.isfinite(positions), axis=1)
    classes = [np.flatnonzero(finite & (truth_part == part)) for part in (STEM, OTHER_ORGAN)]
    mask = np.zeros(len(truth_part), bool)
    if any(members.size == 0 for members in classes):
        return mask
    for members, others in (classes, classes[::-1]):
        tree = cKDTree(positions[others])
        # The bound leaves out points at exactly that distance, hence the next double.
        nearest = tree.query(positions[members], distance_upper_bound=np.nextafter(distance, 1.0))[
            0
        ]
        mask[members] = np.isfinite(nearest)
    return mask


def plant_accuracy(truth_plant, predicted_plant, truth_of_predicted):
    """Share of the truth's plant points (id >= 0) given to the plant matched with their own.

    truth_of_predicted: {id in the run: id in the truth} of the plants matched by their bases.
    Returns (share, number of points); a plant without a match has none of its points right.
    """
    on_plant = truth_plant >= 0
    predicted = predicted_plant[on_plant]
    known, index = np.unique(predicted, return_inverse=True)
    nothing = np.iinfo(np.int64).min
    as_truth = np.array([truth_of_predicted.get(int(plant), nothing) for plant in known], np.int64)
    right = as_truth[index] == truth_plant[on_plant] if known.size else np.zeros(0, bool)
    return _ratio(np.sum(right), right.size), int(right.size)


def _ratio(part, whole):
    return float(part) / float(whole) if whole else float('nan')
