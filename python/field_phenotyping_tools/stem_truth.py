"""Takes ears and tassel out of a stem label that includes them.

Some labelled clouds of real plants know two classes only and count ears, husks and tassel as stem.
Here those are other organs, and no method can agree with both. Such points are found from the truth
alone, never from what is scored against it, and left out: they count neither for nor against.
"""

import numpy as np
from scipy.spatial import cKDTree

from .segmentation_scores import NO_PART, OTHER_ORGAN, STEM

_BAND = 0.02  # [m] of height; every band has one vote in the axis, however many points it has
_DEGREE = 3  # of the axis' polynomials over height: a stem leans and bends
_ROUNDS = 50  # of reweighting, by when the axis no longer moves
_LEAST_DISTANCE = 0.002  # [m] keeps the weights of points on the axis finite
_RADIUS_FACTOR = 2.0  # times the median distance from the axis still is stem
_TOUCHING = 0.01  # [m] a leaf this near to the stem's points grows out of it
_LEAF_POINTS = 10  # that must touch at one height, so that a stray point is no leaf


def without_ears_and_tassel(positions, part):
    """A copy of `part` with NO_PART where the stem class is no bare stem.

    positions (n, 3) [m], z up, one plant; part (n,) of STEM, OTHER_ORGAN and NO_PART. Left out are
    points of the stem class above the highest leaf's insertion (peduncle and tassel), and those
    further from the stem's own axis than twice the median (ears, husks). Without leaves nothing is
    above, and without a stem nothing changes.
    """
    result = np.array(part)
    stem = np.flatnonzero(part == STEM)
    if stem.size == 0:
        return result
    insertion = np.inf
    for _ in range(2):  # the tassel bends the first axis, and the axis finds the insertion
        kept = stem[positions[stem, 2] <= insertion]
        axis = fit_axis(positions[kept])
        radius = _RADIUS_FACTOR * _median(
            distance_from_axis(positions[kept], axis), _votes(positions[kept, 2])
        )
        near = stem[distance_from_axis(positions[stem], axis) <= radius]
        insertion = highest_insertion(positions[near], positions[part == OTHER_ORGAN])
    bare = near[positions[near, 2] <= insertion]
    result[stem] = NO_PART
    result[bare] = STEM
    return result


def fit_axis(points):
    """Polynomials x(z), y(z) with the least sum of distances, every height having equal weight."""
    low, high = points[:, 2].min(), points[:, 2].max()
    vote = _votes(points[:, 2])
    basis = _basis(points[:, 2], low, high)
    weight = vote
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        coefficients = np.linalg.lstsq(root * basis, root * points[:, :2], rcond=None)[0]
        distance = np.linalg.norm(points[:, :2] - basis.dot(coefficients), axis=1)
        weight = vote / np.maximum(distance, _LEAST_DISTANCE)
    return low, high, coefficients


def distance_from_axis(points, axis):
    """Horizontal distances [m]; the axis goes on straight up and down from its ends."""
    low, high, coefficients = axis
    inside = np.clip(points[:, 2], low, high)
    return np.linalg.norm(points[:, :2] - _basis(inside, low, high).dot(coefficients), axis=1)


def highest_insertion(stem, leaves):
    """Height of the highest band in which leaves touch the stem [m]; infinite where none does."""
    if len(stem) == 0 or len(leaves) == 0:
        return np.inf
    touching = cKDTree(stem).query(leaves, distance_upper_bound=_TOUCHING)[0] <= _TOUCHING
    heights = leaves[touching, 2]
    if heights.size == 0:
        return np.inf
    low = heights.min()
    counts = np.bincount(np.floor((heights - low) / _BAND).astype(int))
    bands = np.flatnonzero(counts >= _LEAF_POINTS)
    return low + (bands[-1] + 1) * _BAND if bands.size else np.inf


def _votes(z):
    """Weights of points by which every band of height counts the same."""
    band = np.floor((z - z.min()) / _BAND).astype(int)
    return 1.0 / np.bincount(band)[band]


def _median(values, weights):
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return values[order][np.searchsorted(share, 0.5 * share[-1])]


def _basis(z, low, high):
    share = (z - low) / max(high - low, _BAND)
    return np.power.outer(share, np.arange(_DEGREE + 1))
