"""Reads what phenotype_cloud --debug says of how the stems were grown."""

import os

import numpy as np

from . import tables
from .errors import InputError

SUMMARY = ('quality', 'iterations', 'r1', 'M', 'alpha', 'beta')
_BASE = ('x', 'y', 'z')
_ENDS = tuple('{}_{}'.format(end, axis) for end in ('start', 'end') for axis in _BASE)
_REGION = ('M', 'branching', 'merged', 'points')


class Growth:
    """How one stem was grown.

    base (3,) [m]; summary: name -> value, of SUMMARY, r1 in metres; and of the regions from the
    base up: start, end (n, 3) [m], M (n,), branching, merged (n,) bool, points (n,), which were
    grown, before pruning. Positions are in the map frame.
    """

    def __init__(self, base, summary, start, end, M, branching, merged, points):
        self.base = base
        self.summary = summary
        self.start = start
        self.end = end
        self.M = M
        self.branching = branching
        self.merged = merged
        self.points = points

    def __len__(self):
        return len(self.M)


def read_growth(folder, plant):
    """The Growth of a plant of a run folder. Raises InputError."""
    if not os.path.isdir(folder):
        raise InputError(
            'No run folder {}. Make one with phenotype_cloud --output {} --debug.'.format(
                folder, folder
            )
        )
    path = _path(folder, 'growth.csv')
    table = tables.read_table(path, ('plant_id',) + _BASE + SUMMARY)
    ids = tables.ids(table, 'plant_id', path)
    found = np.flatnonzero(ids == plant)
    if found.size == 0:
        raise InputError('{} has no plant {}; it has {}.'.format(path, plant, tables.id_list(ids)))
    path = _path(folder, 'growth_regions.csv')
    regions = tables.read_table(path, ('plant_id', 'region') + _ENDS + _REGION)
    own = np.flatnonzero(regions['plant_id'] == plant)
    own = own[np.argsort(regions['region'][own])]
    ends = np.column_stack([regions[name][own] for name in _ENDS])
    return Growth(
        np.array([table[axis][found[0]] for axis in _BASE]),
        {name: float(table[name][found[0]]) for name in SUMMARY},
        ends[:, :3],
        ends[:, 3:],
        regions['M'][own],
        regions['branching'][own] != 0.0,
        regions['merged'][own] != 0.0,
        regions['points'][own].astype(np.int64),
    )


def _path(folder, name):
    path = os.path.join(folder, name)
    if not os.path.isfile(path):
        raise InputError(
            '{} has no {}: the run was made without --debug. Run phenotype_cloud CLOUD --output '
            '{} --debug.'.format(folder, name, folder)
        )
    return path
