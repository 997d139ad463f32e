"""Scores a run of phenotype_cloud, or of the nodelets, against truth or against another run."""

import os

import numpy as np

from . import matching, pcd, segmentation_scores, tables, traits
from .errors import InputError

# Traits scored where both tables have them. The run's standard deviation is in `<name>_stddev`.
TRAITS = ('height', 'stem_diameter', 'stem_diameter_minor', 'lean')
AXIS_TOLERANCE = 0.10  # [m] a stem matches a given axis that passes this near to its base
_SAME_HEIGHT = 0.05  # [m] diameters taken further apart than this along the stem are counted
_SAME_POSITION = 1e-3  # [m] labels.pcd and the truth's cloud must agree this well


class Run:
    """Plants of a run folder, and where its labelled cloud is (None for a live run)."""

    def __init__(self, folder):
        if not os.path.isdir(folder):
            raise InputError(
                'No run folder {}. Make one with phenotype_cloud --output.'.format(folder)
            )
        self.path = os.path.join(folder, 'plants.csv')
        if not os.path.isfile(self.path):
            raise InputError(
                '{} has no plants.csv: not the --output folder of phenotype_cloud, or '
                'that program did not finish.'.format(folder)
            )
        self.table = tables.read_table(self.path, ('plant_id', 'x', 'y', 'z'))
        self.ids = tables.ids(self.table, 'plant_id', self.path)
        self.bases = np.column_stack([self.table[axis] for axis in 'xyz'])
        labels = os.path.join(folder, 'labels.pcd')
        self.labels_path = labels if os.path.isfile(labels) else None

    def __len__(self):
        return len(self.ids)

    def trait(self, name):
        return tables.column_or_nan(self.table, name, len(self))

    def text(self, name):
        column = self.table.get(name)
        return [''] * len(self) if column is None else [str(cell) for cell in column]

    def labels(self):
        cloud = pcd.read_pcd(self.labels_path)
        pcd.require_fields(cloud, ('plant_id', 'part'), self.labels_path)
        return cloud


class Report:
    """What evaluate prints: figures by name, notes for the reader, and a row for every plant."""

    def __init__(self):
        self.figures = {}
        self.notes = []
        self.rows = []

    def add(self, prefix, scores):
        self.figures.update(('{}{}'.format(prefix, name), value) for name, value in scores.items())


def evaluate(run, truth_path, match_radius=None, min_truth_points=0, progress=lambda text: None):
    """Scores a Run against a folder or table of simulate_field, axes, or a labelled cloud.

    match_radius [m]; min_truth_points leaves out true plants with fewer points; `progress` is
    called with a line of text before each slow step. Raises InputError.
    """
    report = describe(run)
    if os.path.isdir(truth_path):
        table_path = os.path.join(truth_path, 'truth.csv')
        cloud_path = os.path.join(truth_path, 'cloud.pcd')
    elif truth_path.lower().endswith('.pcd'):
        table_path, cloud_path = None, truth_path
    else:
        table_path, cloud_path = truth_path, None
    if table_path is None:
        _score_parts(report, run, cloud_path, progress)
        return report
    table = tables.read_table(table_path, ('x', 'y', 'z'))
    if 'axis_x' in table and 'plant_id' not in table:
        _score_axes(report, run, table, table_path, match_radius)
        return report
    truth = _FieldTruth(table, table_path, cloud_path)
    _score_field(report, run, truth, match_radius, min_truth_points, progress)
    return report


def describe(run):
    """What a run says by itself, without any truth."""
    report = Report()
    confident = ['low_confidence' not in flags for flags in run.text('quality')]
    height = run.trait('height')
    report.figures = {
        'found_plants': len(run),
        'confident_plants': int(np.sum(confident)),
        'measured_heights': int(np.isfinite(height).sum()),
        'measured_diameters': int(np.isfinite(run.trait('stem_diameter')).sum()),
        'tallest_plant': float(np.nanmax(height)) if np.isfinite(height).any() else np.nan,
        'shortest_plant': float(np.nanmin(height)) if np.isfinite(height).any() else np.nan,
    }
    report.rows = [_run_row('found', run, b) for b in range(len(run))]
    return report


def compare(run, other, match_radius=None):
    """Differences between the matched plants of two runs, absolute, in metres."""
    report = describe(run)
    radius = _radius(match_radius, other.bases[:, :2])
    pairs, _ = matching.match_bases(run.bases[:, :2], other.bases[:, :2], radius)
    i, j = pairs[:, 0], pairs[:, 1]
    report.figures.update(
        {
            'match_radius': radius,
            'other_plants': len(other),
            'matched': len(pairs),
            'only_in_run': len(run) - len(pairs),
            'only_in_other': len(other) - len(pairs),
        }
    )
    report.add('position_', _quantiles(np.linalg.norm(run.bases[i] - other.bases[j], axis=1)))
    for name in ('height', 'stem_diameter'):
        ours, theirs = run.trait(name)[i], other.trait(name)[j]
        report.add(name + '_', _quantiles(np.abs(ours - theirs)))
        report.figures[name + '_in_one_only'] = int(
            np.sum(np.isfinite(ours) != np.isfinite(theirs))
        )
    report.rows = [_compared_row(run, a, other, b) for a, b in pairs]
    report.rows += [
        dict(_run_row('only in run', run, a), other_id=None)
        for a in np.setdiff1d(np.arange(len(run)), i)
    ]
    report.rows += [
        dict(_run_row('only in other', other, b), plant_id=None, other_id=int(other.ids[b]))
        for b in np.setdiff1d(np.arange(len(other)), j)
    ]
    return report


def _run_row(status, run, b):
    row = {
        'status': status,
        'plant_id': int(run.ids[b]),
        'x': float(run.bases[b, 0]),
        'y': float(run.bases[b, 1]),
        'z': float(run.bases[b, 2]),
    }
    for name in TRAITS:
        row[name] = float(run.trait(name)[b])
        row[name + '_stddev'] = float(run.trait(name + '_stddev')[b])
    row['quality'] = run.text('quality')[b]
    return row


def _compared_row(run, a, other, b):
    row = dict(_run_row('matched', run, a), other_id=int(other.ids[b]))
    for name in TRAITS:
        row[name + '_other'] = float(other.trait(name)[b])
        row[name + '_difference'] = row[name] - row[name + '_other']
    return row


class _FieldTruth:
    """The table, and perhaps the labelled cloud, of simulate_field."""

    def __init__(self, table, table_path, cloud_path):
        tables.require_numbers(table, ('plant_id',), table_path)
        self.table = table
        self.ids = tables.ids(table, 'plant_id', table_path)
        self.bases = np.column_stack([table[axis] for axis in 'xyz'])
        self.table_path = table_path
        self.cloud_path = cloud_path if cloud_path and os.path.isfile(cloud_path) else None

    def __len__(self):
        return len(self.ids)

    def trait(self, name):
        return tables.column_or_nan(self.table, name, len(self))

    def cloud(self):
        cloud = pcd.read_pcd(self.cloud_path)
        pcd.require_fields(cloud, ('plant_id', 'part'), self.cloud_path)
        return cloud

    def seen_points(self, cloud):
        """Points the scanner has of each plant; None where the truth does not say."""
        if 'visible_points' in self.table:
            return self.trait('visible_points')
        if cloud is None:
            return None
        found, counts = np.unique(cloud['plant_id'], return_counts=True)
        count_of = dict(zip(found.tolist(), counts.tolist()))
        return np.array([count_of.get(int(plant), 0) for plant in self.ids], float)


def _score_field(report, run, truth, match_radius, min_truth_points, progress):
    cloud = None
    if truth.cloud_path:
        progress('reading {}'.format(truth.cloud_path))
        cloud = truth.cloud()
    counted = _counted_plants(report, truth, cloud, min_truth_points)
    radius = _radius(match_radius, truth.bases[:, :2])
    pairs, distance = matching.match_bases(truth.bases[:, :2], run.bases[:, :2], radius)
    # A plant found that the scanner hardly saw is neither a hit nor a false one.
    kept = counted[pairs[:, 0]]
    left_out = int(np.sum(~kept))
    hits, hit_distance = pairs[kept], distance[kept]
    _score_detection(report, int(np.sum(counted)), len(run) - left_out, hits, hit_distance, radius)
    for name in TRAITS:
        if name in truth.table and name in run.table:
            deviation = name + '_stddev'
            report.add(
                name + '_',
                traits.score_trait(
                    truth.trait(name)[hits[:, 0]],
                    run.trait(name)[hits[:, 1]],
                    run.trait(deviation)[hits[:, 1]] if deviation in run.table else None,
                ),
            )
    _note_measuring_heights(report, truth, run, hits)
    report.rows = _plant_rows(truth, run, pairs, counted)
    truth_of = {int(run.ids[b]): int(truth.ids[a]) for a, b in pairs}
    _score_labels(report, run, truth, cloud, truth_of, progress)


def _counted_plants(report, truth, cloud, min_truth_points):
    if min_truth_points <= 0:
        return np.ones(len(truth), bool)
    seen = truth.seen_points(cloud)
    if seen is None:
        raise InputError(
            '--min-truth-points needs to know what the scanner saw of each plant: a '
            'column visible_points in {}, or cloud.pcd beside it.'.format(truth.table_path)
        )
    counted = seen >= min_truth_points
    report.notes.append(
        '{} of {} true plants have under {} points and are left out.'.format(
            int(np.sum(~counted)), len(truth), min_truth_points
        )
    )
    return counted


def _radius(given, bases_xy):
    return float(given) if given is not None else matching.default_radius(bases_xy)


def _score_detection(report, true_plants, found, hits, distance, radius):
    matched = len(hits)
    report.figures.update(
        {
            'match_radius': radius,
            'truth_plants': true_plants,
            'matched': matched,
            'missed': true_plants - matched,
            'false_plants': found - matched,
            'recall': _ratio(matched, true_plants),
            'precision': _ratio(matched, found),
            'plant_f1': _ratio(2 * matched, true_plants + found),
            'base_error_median': float(np.median(distance)) if matched else np.nan,
            'base_error_max': float(np.max(distance)) if matched else np.nan,
        }
    )


def _note_measuring_heights(report, truth, run, hits):
    apart = np.abs(
        truth.trait('diameter_height')[hits[:, 0]] - run.trait('diameter_height')[hits[:, 1]]
    )
    count = int(np.sum(apart > _SAME_HEIGHT))
    if count:
        report.notes.append(
            '{} of {} diameters were taken more than {:.0f} cm away from the height of '
            'the true diameter.'.format(count, len(hits), 100.0 * _SAME_HEIGHT)
        )


def _plant_rows(truth, run, pairs, counted):
    """One row a true plant in the truth's order, then one for each false plant."""
    of_truth = dict(pairs.tolist())
    rows = []
    for a in range(len(truth)):
        b = of_truth.get(a)
        status = ('matched' if b is not None else 'missed') if counted[a] else 'left out'
        rows.append(_plant_row(status, truth, a, run, b))
    rows += [
        _plant_row('false', truth, None, run, b)
        for b in np.setdiff1d(np.arange(len(run)), pairs[:, 1])
    ]
    return rows


def _plant_row(status, truth, a, run, b):
    row = {'status': status, 'truth_id': None, 'plant_id': None}
    if b is not None:
        row.update(_run_row(status, run, b))
    if a is not None:
        row.update(
            {
                'truth_id': int(truth.ids[a]),
                'x': float(truth.bases[a, 0]),
                'y': float(truth.bases[a, 1]),
                'z': float(truth.bases[a, 2]),
            }
        )
        row.update({name + '_truth': float(truth.trait(name)[a]) for name in TRAITS})
    if a is not None and b is not None:
        row.update({name + '_error': row[name] - row[name + '_truth'] for name in TRAITS})
    return row


def _score_labels(report, run, truth, cloud, truth_of, progress):
    if cloud is None:
        report.notes.append('Segmentation is not scored: the truth has no cloud.pcd.')
        return
    labels = _labels_of(report, run, cloud, truth.cloud_path, progress)
    if labels is None:
        return
    positions = pcd.xyz(cloud, truth.cloud_path)
    report.add('', segmentation_scores.score_stem_class(positions, cloud['part'], labels['part']))
    share, points = segmentation_scores.plant_accuracy(
        cloud['plant_id'], labels['plant_id'], truth_of
    )
    report.figures.update({'plant_accuracy': share, 'plant_points': points})


def _score_parts(report, run, cloud_path, progress):
    progress('reading {}'.format(cloud_path))
    cloud = pcd.read_pcd(cloud_path)
    pcd.require_fields(cloud, ('part',), cloud_path)
    labelled = cloud['part'] != segmentation_scores.NO_PART
    if not labelled.any():
        report.notes.append(
            'Segmentation is not scored: no point of {} has a label.'.format(cloud_path)
        )
        return
    labels = _labels_of(report, run, cloud, cloud_path, progress)
    if labels is None:
        return
    report.notes.append(
        '{} of {} points are labelled; only those are scored.'.format(
            int(labelled.sum()), labelled.size
        )
    )
    report.add(
        '',
        segmentation_scores.score_stem_class(
            pcd.xyz(cloud, cloud_path), cloud['part'], labels['part'], labelled
        ),
    )


def _labels_of(report, run, cloud, cloud_path, progress):
    """The run's labels, point by point those of `cloud`; None, with a note, where it has none."""
    if run.labels_path is None:
        report.notes.append('Segmentation is not scored: the run has no labels.pcd (a live run?).')
        return None
    progress('reading {}'.format(run.labels_path))
    labels = run.labels()
    cure = 'Run phenotype_cloud on that very file.'
    if len(labels) != len(cloud):
        raise InputError(
            '{} has {} points, {} has {}: not a run on this cloud. {}'.format(
                run.labels_path, len(labels), cloud_path, len(cloud), cure
            )
        )
    ours, theirs = pcd.xyz(labels, run.labels_path), pcd.xyz(cloud, cloud_path)
    with np.errstate(invalid='ignore'):
        single = np.finfo(np.float32).eps * np.abs(theirs)  # either file may hold float32
        differ = np.flatnonzero(np.any(np.abs(ours - theirs) > _SAME_POSITION + single, axis=1))
    if differ.size:
        raise InputError(
            '{} and {} hold different points, the first at index {}: not a run on this '
            'cloud, or points in another order. {}'.format(
                run.labels_path, cloud_path, differ[0], cure
            )
        )
    progress('scoring {} points'.format(len(cloud)))
    return labels


def _score_axes(report, run, table, path, match_radius):
    names = ('x', 'y', 'z', 'axis_x', 'axis_y', 'axis_z')
    tables.require_numbers(table, names, path)
    points = np.column_stack([table[name] for name in names[:3]])
    directions = np.column_stack([table[name] for name in names[3:]])
    if not np.all(np.abs(directions[:, 2]) > 1e-6):
        raise InputError(
            '{}: an axis lies flat or has no direction; its axis_z must differ from 0.'.format(path)
        )
    radius = AXIS_TOLERANCE if match_radius is None else float(match_radius)
    hits, distance = matching.match_bases_to_axes(points, directions, run.bases, radius)
    _score_detection(report, len(points), len(run), hits, distance, radius)
    report.notes.append(
        'Distances are horizontal, between the given axis and the plant\'s base at '
        'the height of that base.'
    )
    ours = np.column_stack([run.trait(name)[hits[:, 1]] for name in names[3:]])
    if np.isfinite(ours).any():
        report.add('axis_angle_', _quantiles(_angle(directions[hits[:, 0]], ours)))
    plant = table.get('plant', np.arange(len(points)))
    report.rows = _axis_rows(run, plant, points, hits, distance)


def _axis_rows(run, plant, points, hits, distance):
    of_axis = {int(a): (int(b), float(d)) for (a, b), d in zip(hits, distance)}
    rows = []
    for a in range(len(points)):
        b, apart = of_axis.get(a, (None, np.nan))
        row = {'status': 'missed', 'plant_id': None} if b is None else _run_row('matched', run, b)
        row.update(
            {
                'truth_id': int(plant[a]),
                'x': float(points[a, 0]),
                'y': float(points[a, 1]),
                'z': float(points[a, 2]),
                'distance': apart,
            }
        )
        rows.append(row)
    rows += [
        dict(_run_row('false', run, b), truth_id=None)
        for b in np.setdiff1d(np.arange(len(run)), hits[:, 1])
    ]
    return rows


def _angle(first, second):
    """Angles between lines [rad]."""
    dots = np.abs(np.sum(first * second, axis=1))
    return np.arccos(
        np.clip(dots / (np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)), 0.0, 1.0)
    )


def _quantiles(values):
    values = values[np.isfinite(values)]
    if values.size == 0:
        return {'n': 0, 'median': np.nan, 'q90': np.nan, 'q95': np.nan, 'max': np.nan}
    return {
        'n': int(values.size),
        'median': float(np.median(values)),
        'q90': float(np.percentile(values, 90)),
        'q95': float(np.percentile(values, 95)),
        'max': float(values.max()),
    }


def _ratio(part, whole):
    return float(part) / float(whole) if whole else float('nan')
