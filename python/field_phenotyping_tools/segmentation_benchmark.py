"""The tables of benchmark_segmentation.

Each takes a Bench and a folder for pictures, prints itself row by row and returns {row: figures}.
"""

import json
import os

import numpy as np

from . import pcd, segmentation_scores, stem_truth
from .benchmarks import (
    HARD_FIELDS,
    STAGES,
    cloud_of,
    figure,
    note_load,
    print_header,
    print_row,
    real_data,
    score,
    stage_times,
)
from .errors import InputError

# What the segmentation is to reach on plain fields.
GOALS = {
    'recall': 0.98,
    'precision': 0.98,
    'sa': 0.97,
    'stem_f1': 0.94,
    'stem_iou': 0.88,
    'bp': 0.93,
    'plant_accuracy': 0.95,
}
MOST_SCALING = 9.0  # times the seconds for 8 times the plants, at most

# Table 1 of the paper [%], on its own field data: M = 0.1, 0.2 ... 0.9.
SWEEP = tuple(round(0.1 * step, 1) for step in range(1, 10))
PAPER_SWEEP = {
    'sa': (89.2, 91.7, 93.5, 94.8, 96.2, 95.1, 93.9, 92.3, 90.6),
    'stem_f1': (85.6, 88.4, 90.7, 92.1, 93.8, 92.5, 91.2, 89.4, 87.1),
    'bp': (83.7, 86.9, 89.3, 91.2, 92.6, 91.8, 90.1, 88.5, 85.9),
    'stem_iou': (79.3, 82.6, 84.8, 86.2, 87.4, 86.1, 84.5, 82.4, 80.7),
}
# Table 5 of the paper: SA and seconds on its own field data and computer.
PAPER_RIVALS = {
    'PCL region growing, the paper\'s figures': {'sa': 0.916, 'segmentation_s': 15.2},
    'CRPCP, the paper\'s figures': {'sa': 0.962, 'segmentation_s': 16.0},
}

_SMALL_FIELD = ['--rows', '2', '--plants-per-row', '20', '--points', '300000']  # 40 plants
_SCALING_POINTS = 7500  # a plant, as in the default field
_SCALING_ROWS = {1: (4, 5), 8: (8, 20)}  # times the plants: rows, plants in each

_SEGMENTATION = (
    ('recall', figure('recall', decimals=3)),
    ('precision', figure('precision', decimals=3)),
    ('SA', figure('sa', decimals=3)),
    ('stem F1', figure('stem_f1', decimals=3)),
    ('IoU', figure('stem_iou', decimals=3)),
    ('BP', figure('bp', decimals=3)),
)
_WITH_PLANTS = _SEGMENTATION + (('plant accuracy', figure('plant_accuracy', decimals=3)),)


def fields(bench, _folder):
    """Plain fields at three stages beside the goals."""
    print_header('field of 120 plants, 0.75 x 0.20 m, noise 3 mm [shares]', _WITH_PLANTS)
    print_row('goal, at least', _WITH_PLANTS, GOALS)
    rows = {}
    for stage in STAGES:
        bench.progress('fields: ' + stage)
        rows[stage] = bench.simulated_figures('--stage', stage)
        print_row(stage, _WITH_PLANTS, rows[stage])
    return rows


def hard(bench, _folder):
    """Fields that are harder than most."""
    print_header('field of 80 plants, tasselling if not said [shares]', _WITH_PLANTS)
    rows = {}
    for label, settings in HARD_FIELDS:
        bench.progress('hard: ' + label)
        rows[label] = bench.simulated_figures(*settings)
        print_row(label, _WITH_PLANTS, rows[label])
    return rows


def m_sweep(bench, folder, field=_SMALL_FIELD, values=SWEEP):
    """Table 1 of the paper: what the similarity threshold M does."""
    bench.progress('m_sweep: simulating')
    truth = bench.simulate(*field)
    rows = {}
    for value in values:
        bench.progress('m_sweep: M = {}'.format(value))
        run = bench.measure(cloud_of(truth), '--set', 'segmentation/M={}'.format(value))
        rows[value] = score(run, truth)
    columns = [(str(value), _at(value)) for value in values]
    print_header('M [-], tasselling, figures in percent', columns)
    names = (('SA', 'sa'), ('stem F1', 'stem_f1'), ('BP', 'bp'), ('IoU', 'stem_iou'))
    for title, name in names:
        ours = {value: 100.0 * rows[value][name] for value in values}
        print_row(title + ' [%]', columns, ours)
        print_row(
            title + ' [%], the paper\'s figure on its own field',
            columns,
            dict(zip(SWEEP, PAPER_SWEEP[name])),
        )
    from . import plots  # matplotlib takes a second to load

    path = os.path.join(folder, 'm_sweep.png')
    plots.similarity_sweep(
        path,
        values,
        {title: [100.0 * rows[value][name] for value in values] for title, name in names},
        SWEEP,
        {title: PAPER_SWEEP[name] for title, name in names},
    )
    print('\nWrote {}'.format(path), flush=True)
    return rows


def _at(value):
    return lambda row: '-' if value not in row else '{:.1f}'.format(row[value])


def rivals(bench, _folder, stages=STAGES, field=_SMALL_FIELD, grid=()):
    """Table 5 of the paper: PCL's region growing, and its Euclidean clustering.

    grid: options of pcl_clusters that make its grid smaller.
    """
    columns = _SEGMENTATION + (
        ('segmentation, one core [s]', figure('segmentation_s', decimals=1)),
        ('whole, one core [s]', figure('whole_s', decimals=1)),
        ('segmentation time, share of ours', figure('time_ratio')),
    )
    print_header('40 plants, 300,000 points; method [shares]', columns)
    for label, figures in PAPER_RIVALS.items():
        print_row(label, columns, figures)
    rows, notes = {}, []
    for stage in stages:
        bench.progress('rivals: {}: simulating'.format(stage))
        truth = bench.simulate('--stage', stage, *field)
        bench.progress('rivals: {}: ours'.format(stage))
        run = bench.measure(cloud_of(truth), '--threads', '1')
        times = stage_times(run)
        ours = dict(
            score(run, truth),
            segmentation_s=times['segmentation'],
            whole_s=times['whole'],
            time_ratio=1.0,
        )
        rows[stage + ', ours, default parameters'] = ours
        print_row(stage + ', ours, default parameters', columns, ours)
        for method, name in (
            ('region_growing', 'PCL region growing'),
            ('euclidean', 'PCL Euclidean clusters'),
        ):
            bench.progress('rivals: {}: {}'.format(stage, name))
            run = bench.cluster(cloud_of(truth), method, *grid)
            with open(os.path.join(run, 'result.json')) as file:
                result = json.load(file)
            label = '{}, {}, best of its grid'.format(stage, name)
            rows[label] = dict(score(run, truth), **rival_times(result, times['segmentation']))
            print_row(label, columns, rows[label])
            notes.append('{}: {}'.format(label, settings_text(result)))
    note_load()
    print('\nSettings that were best:\n')
    for note in notes:
        print('- ' + note, flush=True)
    return rows


def rival_times(result, our_seconds):
    """Seconds of a result.json of pcl_clusters, for the settings that it kept."""
    seconds = result['seconds']
    segmentation = sum(seconds[step] for step in ('normals', 'clustering', 'rule'))
    return {
        'segmentation_s': segmentation,
        'whole_s': seconds['preprocessing'] + segmentation,
        'time_ratio': segmentation / our_seconds if our_seconds > 0.0 else float('nan'),
    }


def settings_text(result):
    chosen = list(result['settings'].items()) + list(result['rule'].items())
    return ', '.join('{} {:g}'.format(name, value) for name, value in chosen)


def real(bench, _folder):
    """Real clouds: stems of single plants, and two rows whose stems are known by their axes."""
    data = real_data()
    if data is None:
        return {}
    columns = (
        ('plants found', figure('found_plants', decimals=0)),
        ('stem F1', figure('stem_f1', decimals=3)),
        ('IoU', figure('stem_iou', decimals=3)),
        ('stem precision', figure('stem_precision', decimals=3)),
        ('stem recall', figure('stem_recall', decimals=3)),
        ('of the stem label left out', figure('left_out')),
        ('stem F1 without ears and tassel', figure('bare_stem_f1', decimals=3)),
        ('IoU', figure('bare_stem_iou', decimals=3)),
        ('stem precision', figure('bare_stem_precision', decimals=3)),
        ('stem recall', figure('bare_stem_recall', decimals=3)),
    )
    rows = {}
    print_header('single real plant [shares]', columns)
    for name, has_ears in (
        ('maizefield3d_T8', True),
        ('maizefield3d_A679', True),
        ('maizefield3d_78551S', True),
        ('label3dmaize_v-12-1', False),
        ('label3dmaize_v-9-3', False),
    ):
        bench.progress('real: ' + name)
        cloud = os.path.join(data, name + '.pcd')
        run = bench.measure(cloud)
        rows[name] = score(run, cloud)
        if has_ears:
            rows[name].update(bare_stem_scores(run, cloud))
        print_row(name, columns, rows[name])
    columns = (
        ('true stems', figure('truth_plants', decimals=0)),
        ('found', figure('matched', decimals=0)),
        ('missed', figure('missed', decimals=0)),
        ('false', figure('false_plants', decimals=0)),
        ('base, median error [cm]', figure('base_error_median', 100.0, 1)),
        ('axis, median angle [deg]', figure('axis_angle_median', np.degrees(1.0), 1)),
    )
    print_header('real rows, very sparse', columns)
    name = 'ao2021_two_rows'
    bench.progress('real: ' + name)
    cloud = os.path.join(data, name)
    rows[name] = score(bench.measure(cloud + '.pcd'), cloud + '.truth.csv')
    print_row(name, columns, rows[name])
    return rows


def bare_stem_scores(run, cloud_path):
    """Scores of the stem class where the truth's ears and tassel do not count, as `bare_...`."""
    cloud = pcd.read_pcd(cloud_path)
    positions = pcd.xyz(cloud, cloud_path)
    labels = pcd.read_pcd(os.path.join(run, 'labels.pcd'))
    if len(labels) != len(cloud):
        raise InputError('{} is not a run on {}.'.format(run, cloud_path))
    part = stem_truth.without_ears_and_tassel(positions, cloud['part'])
    scores = segmentation_scores.score_stem_class(
        positions, part, labels['part'], part != segmentation_scores.NO_PART
    )
    figures = {'bare_' + name: value for name, value in scores.items()}
    stem = cloud['part'] == segmentation_scores.STEM
    figures['left_out'] = float(np.mean(part[stem] == segmentation_scores.NO_PART))
    return figures


def scaling(bench, _folder, plants=_SCALING_ROWS):
    """How the segmentation's time grows with the field."""
    columns = (
        ('plants', figure('truth_plants', decimals=0)),
        ('points', figure('points', decimals=0)),
        ('segmentation, one core [s]', figure('segmentation_s', decimals=1)),
        ('whole, one core [s]', figure('whole_s', decimals=1)),
        ('segmentation time, of the small field\'s', figure('time_ratio', decimals=1)),
    )
    print_header('field, tasselling', columns)
    rows = {}
    for times, (row_count, in_each) in plants.items():
        label = '{} x'.format(times)
        bench.progress('scaling: ' + label)
        points = _SCALING_POINTS * row_count * in_each
        size = ['--rows', row_count, '--plants-per-row', in_each, '--points', points]
        field = bench.simulate(*size)
        run = bench.measure(cloud_of(field), '--threads', '1')
        seconds = stage_times(run)
        first = rows.get('1 x', {}).get('segmentation_s', seconds['segmentation'])
        rows[label] = {
            'truth_plants': row_count * in_each,
            'points': points,
            'segmentation_s': seconds['segmentation'],
            'whole_s': seconds['whole'],
            'time_ratio': seconds['segmentation'] / first,
        }
        print_row(label, columns, rows[label])
    print_row('goal for 8 x, at most', columns, {'time_ratio': MOST_SCALING})
    note_load()
    return rows


TABLES = {
    'fields': fields,
    'hard': hard,
    'm_sweep': m_sweep,
    'rivals': rivals,
    'real': real,
    'scaling': scaling,
}
