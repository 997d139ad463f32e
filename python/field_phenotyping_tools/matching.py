"""One-to-one matching of plants by their position."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

BASE_RADIUS = 0.06  # [m] bases match within 6 cm or half the spacing, whichever is less


def median_spacing(xy):
    """Median distance of a plant to its nearest neighbour [m]; infinite for fewer than two."""
    xy = xy[np.all(np.isfinite(xy), axis=1)]
    if len(xy) < 2:
        return np.inf
    return float(np.median(cKDTree(xy).query(xy, k=2)[0][:, 1]))


def default_radius(truth_xy):
    """6 cm, or half the median spacing of the true plants where that is less [m]."""
    half_spacing = 0.5 * median_spacing(truth_xy)
    return min(BASE_RADIUS, half_spacing) if half_spacing > 0.0 else BASE_RADIUS


def match_bases(first_xy, second_xy, radius):
    """One-to-one pairs of points no further apart than `radius` [m].

    As many pairs as possible, and among those sets the one with the least sum of distances. Points
    that are not finite match nothing. Returns (k, 2) indices ordered by the first set and (k,)
    distances.
    """
    first, second = _finite_rows(first_xy), _finite_rows(second_xy)
    if first.size == 0 or second.size == 0:
        return _no_pairs()
    neighbours = cKDTree(first_xy[first]).query_ball_tree(cKDTree(second_xy[second]), radius)
    i = np.repeat(first, [len(found) for found in neighbours])
    j = second[np.array([k for found in neighbours for k in found], dtype=np.int64)]
    distance = np.linalg.norm(first_xy[i] - second_xy[j], axis=1)
    return _assign(i, j, distance, len(first_xy), len(second_xy))


def close_pairs(xy, radius):
    """Pairs of indices of points that lie nearer together than `radius` [m]."""
    finite = _finite_rows(xy)
    return [
        (int(finite[i]), int(finite[j]))
        for i, j in sorted(cKDTree(xy[finite]).query_pairs(radius))
    ]


def match_bases_to_axes(points, directions, bases, radius):
    """As match_bases, for straight axes (a point on, and the direction of, each) and bases (n, 3).

    The distance is the horizontal one at the height of the base.
    """
    if len(points) == 0 or len(bases) == 0:
        return _no_pairs()
    rise = bases[None, :, 2] - points[:, None, 2]
    at_height = points[:, None, :2] + rise[:, :, None] * (
        directions[:, None, :2] / directions[:, None, 2:3]
    )
    distance = np.linalg.norm(at_height - bases[None, :, :2], axis=2)
    i, j = np.nonzero(distance <= radius)
    return _assign(i, j, distance[i, j], len(points), len(bases))


def _finite_rows(xy):
    return np.flatnonzero(np.all(np.isfinite(xy), axis=1))


def _no_pairs():
    return np.empty((0, 2), np.int64), np.empty(0)


def _assign(i, j, distance, size_i, size_j):
    """Solves the assignment within each group of plants that can be mistaken for one another."""
    if len(i) == 0:
        return _no_pairs()
    size = size_i + size_j
    graph = coo_matrix((np.ones(len(i)), (i, j + size_i)), shape=(size, size))
    group = connected_components(graph, directed=False)[1][i]
    order = np.argsort(group, kind='stable')
    starts = np.flatnonzero(np.diff(group[order])) + 1
    pairs = np.concatenate(
        [
            edges[_assign_group(i[edges], j[edges], distance[edges])]
            for edges in np.split(order, starts)
        ]
    )
    pairs = pairs[np.argsort(i[pairs])]
    return np.column_stack([i[pairs], j[pairs]]), distance[pairs]


def _assign_group(i, j, distance):
    """Indices of the edges chosen; a pair left out costs more than all edges together."""
    rows, row_of = np.unique(i, return_inverse=True)
    columns, column_of = np.unique(j, return_inverse=True)
    cost = np.full((len(rows), len(columns)), distance.sum() + 1.0)
    edge = np.full(cost.shape, -1)
    cost[row_of, column_of] = distance
    edge[row_of, column_of] = np.arange(len(i))
    chosen = edge[linear_sum_assignment(cost)]
    return chosen[chosen >= 0]
