"""The tables of benchmark_live.

Each takes a Bench and a folder for pictures, prints itself and returns {row: figures}.
"""

import json
import os
import sqlite3

import numpy as np

from . import evaluation, matching, tables, traits
from .benchmarks import figure, note_load, print_header, print_row

TRAITS = ('height', 'stem_diameter')
COVERAGE = '0.90 - 0.99'
REPLAY_GOAL = 5.0  # times real time, 300,000 points/s
SAME_HEIGHT = 1e-2  # [m] of a plant, from the scans and from the merged cloud
SAME_DIAMETER = 0.5e-3  # [m]


def _settings(field):
    with open(os.path.join(field, 'simulation.json')) as file:
        return json.load(file)


def single_passes(journal):
    """{plant_id: [{trait: (value, stddev)} of each pass, oldest first]} of a journal.

    Passes of a block are told apart by when it was first seen; the newest revision of each counts.
    """
    with sqlite3.connect(journal) as database:
        rows = database.execute(
            'SELECT plant_id, began_ns, height, height_stddev, stem_diameter, stem_diameter_stddev '
            'FROM plant JOIN report ON report = number ORDER BY number'
        ).fetchall()
    passes = {}
    for plant, began, *values in rows:
        height, height_stddev, diameter, diameter_stddev = (
            np.nan if value is None else value for value in values
        )
        passes.setdefault(plant, {})[began] = {
            'height': (height, height_stddev),
            'stem_diameter': (diameter, diameter_stddev),
        }
    return {plant: [found[began] for began in sorted(found)] for plant, found in passes.items()}


def passes_table(bench, _):
    """Each row of plants from one side, then from the other, in a map that has moved by 10 cm."""
    rows = {}
    columns = [
        ('plants', figure('plants', decimals=0)),
        ('found', figure('found', decimals=0)),
        ('with two ids', figure('duplicates', decimals=0)),
        ('no plant', figure('false', decimals=0)),
        ('seen in both', figure('both', decimals=0)),
        ('height: stddev of one pass, fused [cm]', _two('height', 1e2)),
        ('coverage', figure('height_coverage', decimals=3)),
        ('diameter: stddev of one pass, fused [mm]', _two('stem_diameter', 1e3)),
        ('coverage', figure('stem_diameter_coverage', decimals=3)),
    ]
    print_header('map moved by', columns)
    goal = ['500', '500', '0', '0', '-', 'less', COVERAGE, 'less', COVERAGE]
    print('| {} |'.format(' | '.join(['goal'] + goal)))
    for shift in (0.0, 0.1):
        label = '{:.0f} cm'.format(1e2 * shift)
        bench.progress('500 plants, two passes, map moved by ' + label)
        field = bench.drive(
            *('--rows', '5', '--plants-per-row', '100', '--lane-every', '2', '--passes', '2'),
            *('--map-shift', shift, '--points', '0', '--speed', '0.9'),
        )
        run, _ = bench.replay(os.path.join(field, 'field.bag'))
        rows[label] = _score_passes(field, run)
        print_row(label, columns, rows[label])
    return rows


def _two(trait, scale):
    def text(figures):
        if not np.isfinite(figures[trait + '_stddev_fused']):
            return '-'
        return '{:.2f}, {:.2f}'.format(
            scale * figures[trait + '_stddev_one'], scale * figures[trait + '_stddev_fused']
        )

    return text


def _score_passes(field, folder):
    run = evaluation.Run(folder)
    path = os.path.join(field, 'truth.csv')
    truth = tables.read_table(path, ('x', 'y', 'z') + TRAITS)
    shift = _settings(field)['map_shifts'][-1]
    at = np.column_stack([truth['x'] + shift['x_m'], truth['y'] + shift['y_m']])
    pairs, _ = matching.match_bases(run.bases[:, :2], at, matching.default_radius(at))
    ours, theirs = pairs[:, 0], pairs[:, 1]
    # A second id of a plant lies where the first pass has seen it, or beside the new place.
    rest = np.setdiff1d(np.arange(len(run)), ours)
    nearest = [
        np.min(np.hypot(*(np.vstack([at, at - [shift['x_m'], shift['y_m']]]) - base).T))
        for base in run.bases[rest, :2]
    ]
    twice = int(np.sum(np.array(nearest) < matching.default_radius(at)))
    both = run.trait('passes')[ours] >= 2
    figures = {
        'plants': len(at),
        'found': len(pairs),
        'duplicates': twice,
        'false': len(rest) - twice,
        'both': int(np.sum(both)),
    }
    single = single_passes(os.path.join(folder, 'journal.sqlite'))
    for trait in TRAITS:
        value, stddev = run.trait(trait)[ours][both], run.trait(trait + '_stddev')[ours][both]
        scores = traits.score_trait(truth[trait][theirs][both], value, stddev)
        one = [single[plant][-1][trait][1] for plant in run.ids[ours][both]]
        figures[trait + '_coverage'] = scores['coverage']
        figures[trait + '_rmse'] = scores['rmse']
        figures[trait + '_stddev_fused'] = float(np.nanmedian(stddev))
        figures[trait + '_stddev_one'] = float(np.nanmedian(one))
    return figures


def clouds_table(bench, _):
    """The plants of a drive, from its scans through the nodelets and from its merged cloud."""
    columns = [
        ('plants', figure('other_plants', decimals=0)),
        ('one to one', figure('matched', decimals=0)),
        ('height within 1 cm', figure('same_height', decimals=3)),
        ('diameter within 0.5 mm', figure('same_diameter', decimals=3)),
        ('times real time', figure('times', decimals=1)),
        ('points/s of the drive', figure('rate', decimals=0)),
    ]
    print_header('stage', columns)
    print('| goal | 120 | 120 | 1.000 | 1.000 | {:.1f} | 300000 |'.format(REPLAY_GOAL))
    rows = {}
    for stage in ('tasselling', 'ripe'):
        bench.progress('120 {} plants: scans and merged cloud'.format(stage))
        field = bench.drive('--stage', stage)
        folder, seconds = bench.replay(os.path.join(field, 'field.bag'))
        offline = bench.measure(os.path.join(field, 'cloud.pcd'))
        live, other = evaluation.Run(folder), evaluation.Run(offline)
        rows[stage] = evaluation.compare(live, other).figures
        pairs, _ = matching.match_bases(
            live.bases[:, :2], other.bases[:, :2], matching.default_radius(other.bases[:, :2])
        )
        for trait, most in (('height', SAME_HEIGHT), ('stem_diameter', SAME_DIAMETER)):
            off = np.abs(live.trait(trait)[pairs[:, 0]] - other.trait(trait)[pairs[:, 1]])
            name = 'same_' + trait.replace('stem_', '')
            rows[stage][name] = float(np.mean(off[np.isfinite(off)] <= most))
        totals = _settings(field)['totals']
        rows[stage]['times'] = totals['duration_s'] / seconds
        rows[stage]['rate'] = totals['points'] / totals['duration_s']
        print_row(stage, columns, rows[stage])
    note_load()
    return rows


TABLES = {'passes': passes_table, 'clouds': clouds_table}
