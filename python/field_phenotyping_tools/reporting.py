"""Figures and plants as text, JSON and CSV."""

import csv
import json
import math

import numpy as np

from .evaluation import TRAITS

# (title, unit, units in one metre or radian, decimals) of each trait
TRAIT_UNITS = {
    'height': ('height', 'cm', 100.0, 2),
    'stem_diameter': ('stem diameter, major', 'mm', 1000.0, 2),
    'stem_diameter_minor': ('stem diameter, minor', 'mm', 1000.0, 2),
    'lean': ('lean', 'deg', 180.0 / math.pi, 2),
}
_PLANT_TABLE_TRAITS = ('height', 'stem_diameter')


def format_report(report):
    """The figures as text for people; what was not scored is not shown."""
    figures = report.figures
    lines = []
    if 'recall' in figures:
        lines += _detection_lines(figures)
    elif 'other_plants' in figures:
        lines += _comparison_lines(figures)
    else:
        lines += [
            'Plants',
            '  found {found_plants}, with a height {measured_heights}, with a stem '
            'diameter {measured_diameters}'.format(**figures),
        ]
    if 'sa' in figures:
        lines += _segmentation_lines(figures)
    lines += ['Note: ' + note for note in report.notes]
    return '\n'.join(lines)


def format_plants(rows):
    """One line a plant, the truth (or the other run) beside the estimate; rows of a Report."""
    against, difference = 'truth', 'error'
    if any('other_id' in row for row in rows):
        against, difference = 'other', 'difference'
    names, units = [against, 'plant', 'x', 'y'], ['id', 'id', 'm', 'm']
    for name in _PLANT_TABLE_TRAITS:
        names += [name.replace('stem_', ''), against, difference, '+-sd']
        units += [TRAIT_UNITS[name][1]] * 4
    lines = [names + ['status'], units + ['']]
    for row in rows:
        cells = [
            _id(row.get(against + '_id')),
            _id(row['plant_id']),
            '{:.2f}'.format(row['x']),
            '{:.2f}'.format(row['y']),
        ]
        for name in _PLANT_TABLE_TRAITS:
            scale = TRAIT_UNITS[name][2]
            cells += [
                _number(row.get(name + part, np.nan) * scale, 1)
                for part in ('', '_' + against, '_' + difference, '_stddev')
            ]
        quality = row.get('quality', '')
        lines.append(
            cells
            + [row['status'] if quality in ('', 'ok') else '{} ({})'.format(row['status'], quality)]
        )
    return _aligned(lines)


def write_json(path, report):
    """Figures, notes and plants in metres and radians; what is not a number becomes null."""
    with open(path, 'w') as file:
        json.dump(
            {
                'figures': _plain(report.figures),
                'notes': report.notes,
                'plants': [_plain(row) for row in report.rows],
            },
            file,
            indent=2,
        )
        file.write('\n')


def worst_plants(rows, count):
    """Missed and false plants first, then the matched ones with the largest error.

    Errors of height and diameter are compared by the multiple of their root mean square.
    """
    unmatched = [row for row in rows if row['status'] in ('missed', 'false')]
    matched = [row for row in rows if row['status'] == 'matched']
    severity = np.zeros(len(matched))
    for name in _PLANT_TABLE_TRAITS:
        error = np.abs([row.get(name + '_error', np.nan) for row in matched])
        known = np.isfinite(error)
        if known.any() and np.any(error[known] > 0.0):
            severity[known] = np.maximum(
                severity[known], error[known] / np.sqrt(np.mean(error[known] ** 2))
            )
    order = np.argsort(-severity, kind='stable')
    return (unmatched + [matched[k] for k in order])[:count]


def write_plants(path, rows):
    """The rows as CSV, metres and radians, `nan` where there is no value."""
    fullest_first = sorted(rows, key=len, reverse=True)
    names = list(dict.fromkeys(name for row in fullest_first for name in row)) or ['status']
    with open(path, 'w', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(names)
        for row in rows:
            writer.writerow(['nan' if row.get(name) is None else row[name] for name in names])


def _detection_lines(figures):
    lines = [
        'Plants (bases matched one to one, no further apart than {:.1f} cm horizontally)'.format(
            100.0 * figures['match_radius']
        ),
        '  truth {truth_plants}   found {found_plants}   matched {matched}   missed {missed}   '
        'false {false_plants}'.format(**figures),
        '  recall {}   precision {}   F1 {}   base error: median {} cm, largest {} cm'.format(
            *[_number(figures[name], 3) for name in ('recall', 'precision', 'plant_f1')],
            *[
                _number(100.0 * figures[name], 2)
                for name in ('base_error_median', 'base_error_max')
            ],
        ),
    ]
    if 'axis_angle_median' in figures:
        lines.append(
            '  angle to the given axes: median {} deg, largest {} deg'.format(
                *[
                    _number(math.degrees(figures['axis_angle_' + name]), 2)
                    for name in ('median', 'max')
                ]
            )
        )
    scored = [name for name in TRAITS if name + '_n' in figures]
    if scored:
        lines += [
            '',
            'Traits of the matched plants (error = measured - true)',
            _aligned([_TRAIT_HEADER] + [_trait_cells(figures, name) for name in scored]),
            '  R2 = 1 - SS_res/SS_tot; r2 = squared correlation; coverage = share of the truth '
            'within\n  +-1.96 reported standard deviations, which should be 0.95',
        ]
    return lines


_TRAIT_HEADER = ['  ', '', 'n', 'R2', 'r2', 'RMSE', 'MAE', 'bias', 'median |error|', 'coverage']


def _trait_cells(figures, name):
    title, unit, scale, decimals = TRAIT_UNITS[name]
    cells = ['  ' + title, unit, str(figures[name + '_n'])]
    cells += [_number(figures[name + '_' + score], 3) for score in ('r2', 'squared_correlation')]
    cells += [
        _number(scale * figures[name + '_' + score], decimals)
        for score in ('rmse', 'mae', 'bias', 'median_abs_error')
    ]
    return cells + [_number(figures[name + '_coverage'], 3)]


def _comparison_lines(figures):
    lines = [
        'Two runs (bases matched one to one, no further apart than {:.1f} cm horizontally)'.format(
            100.0 * figures['match_radius']
        ),
        '  run {found_plants}   other {other_plants}   matched {matched}   '
        'only in run {only_in_run}   only in other {only_in_other}'.format(**figures),
        '',
        'Absolute differences',
    ]
    rows = [['  ', '', 'n', 'median', '90 %', '95 %', 'largest', 'in one only']]
    for name, title, unit, scale in (
        ('position', 'position of the base', 'mm', 1000.0),
        ('height', 'height', 'mm', 1000.0),
        ('stem_diameter', 'stem diameter, major', 'mm', 1000.0),
    ):
        rows.append(
            ['  ' + title, unit, str(figures[name + '_n'])]
            + [
                _number(scale * figures['{}_{}'.format(name, q)], 3)
                for q in ('median', 'q90', 'q95', 'max')
            ]
            + [str(figures.get(name + '_in_one_only', ''))]
        )
    return lines + [_aligned(rows)]


def _segmentation_lines(figures):
    lines = [
        '',
        'Segmentation of the points',
        '  stem: SA {}   F1 {}   IoU {}   precision {}   recall {}   BP {}'.format(
            *[
                _number(figures[name], 3)
                for name in ('sa', 'stem_f1', 'stem_iou', 'stem_precision', 'stem_recall', 'bp')
            ]
        ),
    ]
    if 'plant_accuracy' in figures:
        lines.append(
            '  plant accuracy {} over {} plant points; {} points of ground or weeds taken for '
            'stem'.format(
                _number(figures['plant_accuracy'], 3),
                figures['plant_points'],
                figures['stem_on_ground_points'],
            )
        )
    return lines + [
        '  SA: share of stem and organ points with the right class (all organ already '
        'scores high).\n  BP: precision of the stem class within 1 cm of the other true '
        'class, {} points'.format(figures['boundary_points'])
    ]


def _aligned(rows):
    """Columns padded to their widest cell; the first, and words in the last, to the left."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            (
                cell.ljust(width)
                if i == 0 or (i == len(row) - 1 and not _is_number(row[i]))
                else cell.rjust(width)
            )
            for i, (cell, width) in enumerate(zip(row, widths))
        ]
        lines.append('  '.join(cells).rstrip())
    return '\n'.join(lines)


def _is_number(text):
    return text == '-' or text.replace('.', '').replace('-', '').isdigit()


def _number(value, decimals):
    return '{:.{}f}'.format(value, decimals) if math.isfinite(value) else '-'


def _id(value):
    return '-' if value is None else str(value)


def _plain(values):
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
    }
