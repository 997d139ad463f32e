"""Puts clouds of single real plants together into a field, as a scanner between the rows sees it.

A simulated plant is as regular as its model; real ones lean, bend and reach into one another as they
like, and where each point belongs is known all the same.
"""

import collections
import os

import numpy as np

from . import pcd

_SCANNER_HEIGHT = 1.5  # [m]
_SCANNER_STEP = 0.3  # [m] along a lane
_SCANNER_RANGE = 3.0  # [m]
_BESIDE = 0.4  # [m] of the outer lanes from the outer rows
_MARGIN = 0.75  # [m] of soil round the plants
_BIN = np.radians(0.35)  # of direction: what is not the nearest in its bin is hidden
_THICKNESS = 0.012  # [m] of the nearest
_FOOT = 0.06  # [m] above the lowest point, which shows where a plant stands
_SIZES = (0.9, 1.1)  # plants are made so much smaller to larger
_POSITION_STDDEV = 0.015  # [m]
_SOIL_POINTS = 10000  # on a square metre, before thinning

Layout = collections.namedtuple('Layout', 'rows plants_per_row row_spacing plant_spacing')


def plant_field(folder, sources, layout, seed, noise, size):
    """Writes cloud.pcd and truth.csv of a field into `folder`, as simulate_field does.

    sources: paths of clouds of single plants without soil, z up, which come in turn by chance, each
    turned about its vertical and scaled. Their points are hidden by what stands in front of them,
    thinned to about `size` points with the soil's, and moved along the beam by noise [m]. Their
    `part` is kept, 0 where there is none. Height is that of the highest point, seen or not;
    diameters are not known.
    """
    random = np.random.default_rng(seed)
    plants = [_read_plant(path) for path in sources]
    points, part, owner, truth = [], [], [], []
    for row in range(layout.rows):
        for place in range(layout.plants_per_row):
            base = np.array([place * layout.plant_spacing, row * layout.row_spacing, 0.0])
            base[:2] += random.normal(0.0, _POSITION_STDDEV, 2)
            plant, part_of_plant = plants[random.integers(len(plants))]
            plant = random.uniform(*_SIZES) * plant @ _turn(random.uniform(0.0, 2.0 * np.pi))
            points.append(plant + base)
            part.append(part_of_plant)
            owner.append(np.full(len(plant), len(truth)))
            truth.append((row, base, plant[:, 2].max()))
    points.append(_soil(random, layout))
    part.append(np.zeros(len(points[-1])))
    owner.append(np.full(len(points[-1]), -1))
    points, part, owner = (np.concatenate(values) for values in (points, part, owner))
    weight, beam = _seen(random, points, layout)
    kept = random.random(len(points)) < weight / weight.sum() * size
    points = points[kept] + random.normal(0.0, noise, (kept.sum(), 1)) * beam[kept]
    os.makedirs(folder, exist_ok=True)
    _write_cloud(os.path.join(folder, 'cloud.pcd'), points, owner[kept], part[kept])
    _write_truth(os.path.join(folder, 'truth.csv'), truth)


def _read_plant(path):
    """(its points, standing at the origin; their part)."""
    cloud = pcd.read_pcd(path)
    points = pcd.xyz(cloud, path)
    part = cloud['part'] if 'part' in cloud.dtype.names else np.zeros(len(points))
    low = points[:, 2].min()
    foot = np.median(points[points[:, 2] < low + _FOOT], axis=0)
    return points - [foot[0], foot[1], low], part


def _turn(angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _soil(random, layout):
    length = layout.plants_per_row * layout.plant_spacing
    width = layout.rows * layout.row_spacing
    count = int((length + 2.0 * _MARGIN) * (width + 2.0 * _MARGIN) * _SOIL_POINTS)
    x = random.uniform(-_MARGIN, length + _MARGIN, count)
    y = random.uniform(-_MARGIN, width + _MARGIN, count)
    return np.column_stack([x, y, 0.01 * np.sin(7.0 * x) * np.sin(5.0 * y)])


def _seen(random, points, layout):
    """(how often each point is met, direction of the last beam that met it)."""
    weight = np.zeros(len(points))
    beam = np.zeros((len(points), 3))
    last = (layout.rows - 1) * layout.row_spacing
    lanes = [-_BESIDE, *((np.arange(layout.rows - 1) + 0.5) * layout.row_spacing), last + _BESIDE]
    end = layout.plants_per_row * layout.plant_spacing
    for y in lanes:
        for x in np.arange(-0.6, end + 0.6, _SCANNER_STEP):
            scanner = np.array([x, y, _SCANNER_HEIGHT]) + [0.0, *random.normal(0.0, 0.03, 2)]
            away = points - scanner
            distance = np.linalg.norm(away, axis=1)
            near = np.flatnonzero(distance < _SCANNER_RANGE)
            away, distance = away[near] / distance[near, None], distance[near]
            bins = np.floor(
                np.column_stack([np.arctan2(away[:, 1], away[:, 0]), np.arcsin(away[:, 2])]) / _BIN
            ).astype(np.int64)
            direction = np.unique(bins[:, 0] * 100000 + bins[:, 1], return_inverse=True)[1]
            nearest = np.full(direction.max() + 1, np.inf)
            np.minimum.at(nearest, direction, distance)
            visible = distance < nearest[direction] + _THICKNESS
            # A beam a bin.
            count = np.bincount(direction[visible], minlength=len(nearest))
            weight[near[visible]] += 1.0 / count[direction[visible]]
            beam[near[visible]] = away[visible]
    return weight, beam


def _write_cloud(path, points, owner, part):
    types = [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('plant_id', '<i4'), ('part', 'u1')]
    cloud = np.zeros(len(points), np.dtype(types))
    cloud['x'], cloud['y'], cloud['z'] = points.T
    cloud['plant_id'] = owner
    cloud['part'] = part
    header = (
        'VERSION 0.7\nFIELDS x y z plant_id part\nSIZE 4 4 4 4 1\nTYPE F F F I U\nCOUNT 1 1 1 1 1\n'
        'WIDTH {0}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {0}\nDATA binary\n'
    ).format(len(points))
    with open(path, 'wb') as file:
        file.write(header.encode() + cloud.tobytes())


def _write_truth(path, truth):
    with open(path, 'w') as file:
        file.write('plant_id,row,x,y,z,height\n')
        for plant, (row, base, height) in enumerate(truth):
            file.write('{},{},{:.4f},{:.4f},{:.4f},{:.4f}\n'.format(plant, row, *base, height))
