"""Run and truth folders with known content, and a way to run the programs."""

import csv
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
from numpy.lib.recfunctions import repack_fields

ROOT = os.path.abspath(os.path.join(os.path.dirname(__file__), '..', '..'))
sys.path.insert(0, os.path.join(ROOT, 'python'))

RUN_COLUMNS = (
    'plant_id',
    'x',
    'y',
    'z',
    'height',
    'height_stddev',
    'stem_diameter',
    'stem_diameter_stddev',
    'stem_diameter_minor',
    'diameter_height',
    'lean',
    'arc_coverage',
    'stem_points',
    'plant_points',
    'quality',
)
TRUTH_COLUMNS = (
    'plant_id',
    'row',
    'x',
    'y',
    'z',
    'height',
    'stem_diameter',
    'stem_diameter_minor',
    'diameter_height',
    'stem_length',
    'lean',
    'visible_points',
    'visible_stem_points',
    'axis_x',
    'axis_y',
    'axis_z',
)
LABELS = np.dtype([('x', 'f4'), ('y', 'f4'), ('z', 'f4'), ('plant_id', 'i4'), ('part', 'u1')])
_DEFAULTS = {
    'z': 0.0,
    'height': 2.0,
    'height_stddev': 0.01,
    'stem_diameter': 0.020,
    'stem_diameter_stddev': 0.001,
    'stem_diameter_minor': 0.018,
    'diameter_height': 0.7,
    'lean': 0.05,
    'arc_coverage': 0.5,
    'quality': 'ok',
    'row': 0,
    'stem_length': 1.8,
    'visible_points': 5000,
    'visible_stem_points': 500,
    'stem_points': 400,
    'plant_points': 4000,
    'axis_x': 0.0,
    'axis_y': 0.0,
    'axis_z': 1.0,
}


class FolderTest(unittest.TestCase):
    """Gives every test a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def path(self, *names):
        return os.path.join(self.folder, *names)

    def write_run(self, plants, labels=None, name='run'):
        """plants: dicts with plant_id, x, y and what differs from the defaults."""
        os.makedirs(self.path(name), exist_ok=True)
        write_table(self.path(name, 'plants.csv'), RUN_COLUMNS, plants)
        if labels is not None:
            write_pcd(self.path(name, 'labels.pcd'), labels)
        return self.path(name)

    def write_truth(self, plants, cloud=None, name='truth'):
        os.makedirs(self.path(name), exist_ok=True)
        write_table(self.path(name, 'truth.csv'), TRUTH_COLUMNS, plants)
        if cloud is not None:
            write_pcd(self.path(name, 'cloud.pcd'), cloud)
        return self.path(name)


def write_table(path, columns, rows):
    with open(path, 'w', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in rows:
            writer.writerow([row.get(column, _DEFAULTS.get(column)) for column in columns])


def write_pcd(path, cloud, encoding='binary', body=None):
    """A structured array as PCD; `body` replaces the encoded points."""
    cloud = repack_fields(cloud)
    names = cloud.dtype.names
    types = [cloud.dtype[name] for name in names]
    header = [
        '# .PCD v0.7 - Point Cloud Data file format',
        'VERSION 0.7',
        'FIELDS ' + ' '.join(names),
        'SIZE ' + ' '.join(str(kind.base.itemsize) for kind in types),
        'TYPE ' + ' '.join({'f': 'F', 'i': 'I', 'u': 'U'}[kind.base.kind] for kind in types),
        'COUNT ' + ' '.join(str(int(np.prod(kind.shape))) for kind in types),
        'WIDTH {}'.format(len(cloud)),
        'HEIGHT 1',
        'VIEWPOINT 0 0 0 1 0 0 0',
        'POINTS {}'.format(len(cloud)),
        'DATA ' + encoding,
        '',
    ]
    if body is None:
        body = cloud.tobytes() if encoding == 'binary' else _text(cloud)
    with open(path, 'wb') as file:
        file.write('\n'.join(header).encode() + body)


def _text(cloud):
    rows = (
        ' '.join(
            repr(value.item()) for value in np.hstack([np.ravel(v) for v in point]).astype('f8')
        )
        for point in cloud.tolist()
    )
    return '\n'.join(rows).encode() + b'\n'


def labelled(positions, plant_id, part):
    """A cloud as phenotype_cloud and simulate_field write it."""
    cloud = np.zeros(len(positions), LABELS)
    cloud['x'], cloud['y'], cloud['z'] = np.asarray(positions, float).reshape(-1, 3).T
    cloud['plant_id'], cloud['part'] = plant_id, part
    return cloud


def run_program(name, *arguments):
    """Exit status and output of a Python program of tools/."""
    done = subprocess.run(
        [sys.executable, os.path.join(ROOT, 'tools', name)] + list(arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        universal_newlines=True,
    )
    return done.returncode, done.stdout, done.stderr
