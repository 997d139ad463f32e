"""The tables of benchmark_measurement.

Each takes a Bench and a folder for pictures, prints itself row by row and returns {row: figures}.
"""

import collections
import csv
import os

import numpy as np

from . import matching, tables, traits
from .benchmarks import figure, print_header, print_row, real_data

# What the measurement is to reach. Metres.
MOST_BIAS = 0.15e-3  # 20 mm stems, noise 1 - 4 mm, 100 points on 5 cm, arc >= 180 deg
MOST_OF_BOUND = 1.3  # RMSE, times the Cramer-Rao bound
LOUD_BIAS = 1e-3  # noise 10 mm, 300 points, arc >= 270 deg
GOALS = {  # by noise, through the whole pipeline
    0.003: {'rmse': 0.8e-3, 'squared_correlation': 0.85, 'given': 0.95, 'height_ratio': 1.2},
    0.010: {'rmse': 2.5e-3, 'given': 0.95, 'height_ratio': 1.2},
}
TRUNK_GOALS = {'rmse': 1.0e-2, 'bias': 0.4e-2}
REAL_GOALS = {'rmse': 1.5e-3, 'coverage': '>= 0.90'}
COVERAGE = '0.90 - 0.99'
ENOUGH_POINTS = 200  # of its stem: a plant with as many is to get a diameter
# Table 3 of the paper, on its own data [m]; squared correlation, RMSE, MAE of height and diameter.
PAPER_METHODS = collections.OrderedDict(
    [
        ('this method', ((0.9534, 0.4835e-2, 0.3830e-2), (0.9407, 0.0368e-2, 0.0310e-2))),
        ('voxel estimation', ((0.9203, 0.5803e-2, 0.4502e-2), (0.9102, 0.0451e-2, 0.0403e-2))),
        ('stem side projection', ((0.9005, 0.6302e-2, 0.5003e-2), (0.8904, 0.0501e-2, 0.0432e-2))),
        ('CNN fitting', ((0.9303, 0.5302e-2, 0.4201e-2), (0.9201, 0.0421e-2, 0.0371e-2))),
    ]
)
REAL_CLOUDS = ('maizefield3d_T8', 'maizefield3d_A679', 'maizefield3d_78551S')

_STAGES = ('tasselling', 'ripe')
_FIELD = ('--rows', '3', '--plants-per-row', '20', '--points', '450000')  # 7500 points a plant
_TAKE_CARE = ('poor_fit', 'prior_driven')  # flags of diameters that docs/output.md says not to use


def measure(bench, command, *settings):
    """Rows of a run of measure_stems."""
    return bench.json_rows('measure_stems', command, '--seed', bench.seed, *settings)


def numbers(rows, *keys):
    """Array of a value of every row, NaN for null or where it is missing."""

    def value(row):
        for key in keys:
            row = row.get(key) if row is not None else None
        return np.nan if row is None else row

    return np.array([value(row) for row in rows], float)


def summarise_pieces(rows):
    """Figures of a Monte Carlo."""
    truth = numbers(rows, 'truth')
    figures = traits.score_trait(
        truth, numbers(rows, 'ours', 'value'), numbers(rows, 'ours', 'stddev')
    )
    bound = np.sqrt(np.mean(numbers(rows, 'bound') ** 2))
    figures.update(
        bound=bound,
        of_bound=figures['rmse'] / bound,
        failed=int(np.sum(~np.isfinite(numbers(rows, 'ours', 'value')))),
        prior=float(np.nanmean(numbers(rows, 'prior_share'))),
    )
    for method in ('paper', 'circle'):
        figures[method + '_failed'] = int(np.sum(~np.isfinite(numbers(rows, method))))
        figures[method + '_bias'] = traits.score_trait(truth, numbers(rows, method))['bias']
    return figures


_PIECE_COLUMNS = (
    ('bias [mm]', figure('bias', 1e3)),
    ('RMSE [mm]', figure('rmse', 1e3)),
    ('Cramer-Rao bound [mm]', figure('bound', 1e3)),
    ('RMSE / bound', figure('of_bound')),
    ('coverage', figure('coverage', decimals=3)),
    ('failed', figure('failed', decimals=0)),
    ('bias of a circle [mm]', figure('circle_bias', 1e3, 1)),
    ('bias of Eq 27 [mm]', figure('paper_bias', 1e3, 1)),
    ('of it failed', figure('paper_failed', decimals=0)),
)

# What is varied, one at a time: {title: (option, unit, scale, values)}; the others are as below.
SWEEPS = collections.OrderedDict(
    [
        ('noise', ('--noise', 'mm', 1e-3, (1, 2, 3, 4, 6, 8, 10))),
        ('points', ('--points', '', 1, (10, 20, 50, 100, 200, 500, 1000))),
        ('arc', ('--arc', 'deg', 1, (90, 120, 150, 180, 270, 360))),
        ('diameter', ('--diameter', 'mm', 1e-3, (8, 12, 16, 20, 30, 40))),
    ]
)


def monte_carlo(bench, folder, trials=200, sweeps=SWEEPS, noises=(1, 2, 3, 4)):
    """Single pieces of stem against the Cramer-Rao bound."""
    rows = {}

    def row(label, *settings):
        bench.progress('monte_carlo: ' + label)
        rows[label] = summarise_pieces(measure(bench, 'pieces', '--trials', trials, *settings))
        print_row(label, _PIECE_COLUMNS, rows[label])
        return rows[label]

    print_header('20 mm, b/a 0.8 - 1.0, {} pieces a row'.format(trials), _PIECE_COLUMNS)
    print_row(
        'goal, at most',
        tuple((t, (lambda _: COVERAGE.replace('0.90 - 0.99', '0.92 - 0.98')) if t == 'coverage' else f)
              for t, f in _PIECE_COLUMNS),
        {'bias': MOST_BIAS, 'of_bound': MOST_OF_BOUND},
    )  # fmt: skip
    for span, points in ((0.05, 100), (0.4, 800)):
        for arc in (180, 270, 360):
            for noise in noises:
                row(
                    '{:.0f} cm, {} points, arc {} deg, noise {} mm'.format(
                        100 * span, points, arc, noise
                    ),
                    '--span', span, '--points', points, '--arc', arc, '--noise', 1e-3 * noise,
                )  # fmt: skip

    print_header('20 mm, 300 points on 40 cm, {} pieces a row'.format(trials), _PIECE_COLUMNS)
    print_row('goal, at most', _PIECE_COLUMNS, {'bias': LOUD_BIAS})
    for arc in (270, 360):
        for words, known in (('noise 10 mm, known', ['--noise-known']), ('noise 10 mm', [])):
            row('{}, arc {} deg'.format(words, arc), '--arc', arc, '--noise', 0.010, *known)

    print_header('20 mm, 300 points on 40 cm, noise 3 mm, all round, but:', _PIECE_COLUMNS)
    curves = collections.OrderedDict()
    for title, (option, unit, scale, values) in sweeps.items():
        axis = '{} [{}]'.format(title, unit or '-')
        curves[axis] = [
            (value, row('{} {} {}'.format(title, value, unit).strip(), option, scale * value))
            for value in values
        ]
    from . import plots  # matplotlib takes a second to load

    path = os.path.join(folder, 'measurement_monte_carlo.png')
    plots.estimator_curves(path, curves, MOST_OF_BOUND)
    print('\nWrote {}'.format(path), flush=True)
    return rows


def measured_field(bench, *settings, noise=0.003):
    """[(row of truth.csv, row of measure_stems)] of the plants of a new field that were found."""
    field = bench.simulate('--noise', noise, *settings)
    found = measure(bench, 'field', field, '--noise', noise)
    path = os.path.join(field, 'truth.csv')
    with open(path) as file:
        truth = list(csv.DictReader(file))
    tables.require_numbers(tables.read_table(path, ('x', 'y', 'z')), ('x', 'y'), path)
    places = np.array([(float(t['x']), float(t['y'])) for t in truth])
    found_places = np.array([(r['x'], r['y']) for r in found]).reshape(-1, 2)
    pairs, _ = matching.match_bases(places, found_places, matching.default_radius(places))
    return [(truth[i], found[j]) for i, j in pairs], len(truth)


def true_values(pairs, name):
    return np.array([float(truth[name]) for truth, _ in pairs])


def found_rows(pairs):
    return [found for _, found in pairs]


def summarise_field(pairs, plants):
    """Figures of both traits of the plants of one or more fields."""
    found = found_rows(pairs)
    diameter = numbers(found, 'diameter', 'value')
    truth = true_values(pairs, 'stem_diameter')
    figures = traits.score_trait(truth, diameter, numbers(found, 'diameter', 'stddev'))
    perfect = traits.score_trait(
        truth, numbers(found, 'true_points', 'value'), numbers(found, 'true_points', 'stddev')
    )
    seen = true_values(pairs, 'visible_stem_points') >= ENOUGH_POINTS
    usable = np.array([not set(r['quality'].split('|')) & set(_TAKE_CARE) for r in found])
    height = true_values(pairs, 'height')
    highest = true_values(pairs, 'highest_visible_z') - true_values(pairs, 'z')
    heights = traits.score_trait(
        height, numbers(found, 'height', 'value'), numbers(found, 'height', 'stddev')
    )
    highest_rmse = float(np.sqrt(np.nanmean((highest - height) ** 2)))
    figures.update(
        plants=plants,
        recall=len(pairs) / plants if plants else np.nan,
        given=float(np.mean(np.isfinite(diameter[seen]))) if seen.any() else np.nan,
        usable=float(np.mean(usable[np.isfinite(diameter)])) if np.isfinite(diameter).any() else np.nan,
        perfect_rmse=perfect['rmse'],
        median_bound=float(np.nanmedian(numbers(found, 'bound'))),
        height_rmse=heights['rmse'],
        height_bias=heights['bias'],
        height_coverage=heights['coverage'],
        highest_rmse=highest_rmse,
        height_ratio=heights['rmse'] / highest_rmse,
    )  # fmt: skip
    return figures


_FIELD_COLUMNS = (
    ('found', figure('recall', decimals=3)),
    ('with a diameter, of those with {} stem points'.format(ENOUGH_POINTS), figure('given')),
    ('diameter RMSE [mm]', figure('rmse', 1e3)),
    ('bias [mm]', figure('bias', 1e3)),
    ('squared correlation', figure('squared_correlation')),
    ('coverage', figure('coverage', decimals=3)),
    ('RMSE of our fit on the true stem points [mm]', figure('perfect_rmse', 1e3)),
    ('median bound [mm]', figure('median_bound', 1e3)),
    ('neither poor_fit nor prior_driven', figure('usable')),
    ('height RMSE [mm]', figure('height_rmse', 1e3, 1)),
    ('of the highest true point [mm]', figure('highest_rmse', 1e3, 1)),
    ('ratio', figure('height_ratio')),
    ('bias [mm]', figure('height_bias', 1e3, 1)),
    ('height coverage', figure('height_coverage', decimals=3)),
)


def fields(bench, folder, stages=_STAGES, noises=(0.003, 0.010), seeds=3, field=_FIELD):
    """The whole pipeline on simulated fields."""
    print_header('60 plants, 0.75 x 0.20 m', _FIELD_COLUMNS)
    rows, scatter = {}, []
    for noise in noises:
        columns = tuple(
            (title, (lambda _: COVERAGE) if 'coverage' in title else text)
            for title, text in _FIELD_COLUMNS
        )
        print_row('goal, noise {:.0f} mm'.format(1e3 * noise), columns, GOALS.get(noise, {}))
        for stage in stages:
            everything, plants = [], 0
            for seed in range(bench.seed, bench.seed + seeds):
                label = '{}, noise {:.0f} mm, seed {}'.format(stage, 1e3 * noise, seed)
                bench.progress('fields: ' + label)
                pairs, count = measured_field(
                    bench, '--stage', stage, '--seed', str(seed), *field, noise=noise
                )
                rows[label] = summarise_field(pairs, count)
                print_row(label, _FIELD_COLUMNS, rows[label])
                everything += pairs
                plants += count
            label = '{}, noise {:.0f} mm'.format(stage, 1e3 * noise)
            rows[label] = summarise_field(everything, plants)
            print_row(label + ', all', _FIELD_COLUMNS, rows[label])
            scatter.append((label, everything))
    from . import plots  # matplotlib takes a second to load

    path = os.path.join(folder, 'measurement_fields.png')
    plots.diameter_scatter(
        path,
        [
            (
                label,
                true_values(pairs, 'stem_diameter'),
                numbers(found_rows(pairs), 'diameter', 'value'),
                numbers(found_rows(pairs), 'diameter', 'stddev'),
            )
            for label, pairs in scatter
        ],
    )
    print('\nWrote {}'.format(path), flush=True)
    return rows


def best_settings(rows, trait, truth):
    """{method: (settings, scores)} of the settings with the least RMSE by the truth."""
    estimates = collections.OrderedDict()
    for k, row in enumerate(rows):
        for entry in row[trait + 's']:
            key = (entry['method'], entry['settings'])
            column = estimates.setdefault(key, np.full(len(rows), np.nan))
            column[k] = np.nan if entry['value'] is None else entry['value']
    best = collections.OrderedDict()
    for (method, settings), values in estimates.items():
        scores = traits.score_trait(truth, values)
        if scores['n'] and (method not in best or scores['rmse'] < best[method][1]['rmse']):
            best[method] = (settings, scores)
    return best


def method_scores(pairs):
    """{method: {trait: (settings, scores)}} of Table 3 on the same plants."""
    rows = found_rows(pairs)
    methods = collections.OrderedDict()
    for trait, column in (('height', 'height'), ('diameter', 'stem_diameter')):
        truth = true_values(pairs, column)
        ours = traits.score_trait(truth, numbers(rows, trait, 'value'))
        methods.setdefault('this method', {})[trait] = ('default parameters', ours)
        for method, scored in best_settings(rows, trait, truth).items():
            methods.setdefault(method, {})[trait] = scored
    highest = traits.score_trait(
        true_values(pairs, 'height'), numbers(rows, 'paper_height', 'value')
    )
    methods['paper mode, Eq 27']['height'] = ('highest point, as printed', highest)
    return methods


def rivals(bench, _folder, stages=_STAGES, seeds=2, field=_FIELD):
    """Table 3 of the paper."""

    def text(trait, name, scale=1.0, decimals=2):
        return lambda row: figure(name, scale, decimals)(row.get(trait, {}))

    columns = tuple(
        ('{} {}'.format(trait, title), text(trait, name, scale, decimals))
        for trait, scale, unit in (('height', 1e2, 'cm'), ('diameter', 1e3, 'mm'))
        for title, name, scale, decimals in (
            ('squared correlation', 'squared_correlation', 1.0, 3),
            ('RMSE [{}]'.format(unit), 'rmse', scale, 2),
            ('MAE [{}]'.format(unit), 'mae', scale, 2),
            ('bias [{}]'.format(unit), 'bias', scale, 2),
            ('of plants', 'n', 1.0, 0),
        )
    )
    rows, notes = {}, []
    for stage in stages:
        everything = []
        for seed in range(bench.seed, bench.seed + seeds):
            bench.progress('rivals: {}, seed {}'.format(stage, seed))
            everything += measured_field(bench, '--stage', stage, '--seed', str(seed), *field)[0]
        print_header('{}, noise 3 mm; method'.format(stage), columns)
        for method, scored in method_scores(everything).items():
            label = '{}, {}'.format(stage, method)
            rows[label] = {trait: scores for trait, (_, scores) in scored.items()}
            print_row(method, columns, rows[label])
            notes += ['{}, {}: {}'.format(label, t, words) for t, (words, _) in scored.items()]
    print_header('the paper\'s figures, its own field; method', columns)
    names = ('squared_correlation', 'rmse', 'mae')
    for method, (height, diameter) in PAPER_METHODS.items():
        print_row(
            method,
            columns,
            {'height': dict(zip(names, height)), 'diameter': dict(zip(names, diameter))},
        )
    print('\nSettings, of the other methods those that the truth says are best:\n')
    for note in notes:
        print('- ' + note, flush=True)
    return rows


def trunks(bench, _folder):
    """Real trunks, taped in the field."""
    data = real_data()
    if data is None:
        return {}
    bench.progress('trunks')
    folder = os.path.join(data, 'treescope_trunks')
    with open(os.path.join(folder, 'truth.csv')) as file:
        taped = {row['file']: float(row['stem_diameter_m']) for row in csv.DictReader(file)}
    found = measure(bench, 'trunks', *[os.path.join(folder, name) for name in sorted(taped)])
    truth = np.array([taped[row['file']] for row in found])
    columns = (
        ('RMSE [cm]', figure('rmse', 1e2)),
        ('bias [cm]', figure('bias', 1e2)),
        ('MAE [cm]', figure('mae', 1e2)),
        ('coverage', figure('coverage', decimals=3)),
        ('of {}'.format(len(found)), figure('n', decimals=0)),
    )
    print_header('tree trunks, mobile SLAM LiDAR, taped', columns)
    print_row('goal, at most', columns, TRUNK_GOALS)
    rows = collections.OrderedDict(
        [
            (
                'this method',
                traits.score_trait(
                    truth, numbers(found, 'ours', 'value'), numbers(found, 'ours', 'stddev')
                ),
            ),
            ('paper mode, Eq 27', traits.score_trait(truth, numbers(found, 'paper'))),
            ('circle', traits.score_trait(truth, numbers(found, 'circle'))),
        ]
    )
    for method, scores in rows.items():
        print_row(method, columns, scores)
    return rows


def real(bench, _folder, clouds=REAL_CLOUDS):
    """Real maize stems, thinned and with noise added, against the fit on all their points."""
    data = real_data()
    if data is None:
        return {}
    columns = (
        ('diameters', figure('n', decimals=0)),
        ('RMSE [mm]', figure('rmse', 1e3)),
        ('median of |error| [mm]', figure('median_abs_error', 1e3)),
        ('bias [mm]', figure('bias', 1e3)),
        ('coverage', figure('coverage', decimals=3)),
        ('RMSE of 2 sqrt(ab) [mm]', figure('equivalent_rmse', 1e3)),
        ('points', figure('points', decimals=0)),
    )
    goal = tuple((t, (lambda _: REAL_GOALS['coverage']) if t == 'coverage' else f) for t, f in columns)
    print_header('10 % of the points, noise 3 mm, against all points at the same height', columns)
    print_row('goal, at most', goal, REAL_GOALS)
    rows, everything = {}, []
    for name in clouds:
        bench.progress('real: ' + name)
        found = measure(bench, 'real', os.path.join(data, name + '.pcd'), '--noise', 0.003)
        everything += found
        rows[name] = summarise_real(found)
    sound = [row for row in everything if row['whole_quality'] == 'ok']
    rows['all'] = summarise_real(everything)
    rows['all, where the fit on all points has no flag'] = summarise_real(sound)
    for name, row in rows.items():
        print_row(name, columns, row)
    return rows


def summarise_real(rows):
    """Differences between fits on few points and on all of them; coverage by both deviations."""
    few, whole = numbers(rows, 'thinned', 'value'), numbers(rows, 'whole', 'value')
    stddev = np.hypot(numbers(rows, 'thinned', 'stddev'), numbers(rows, 'whole', 'stddev'))
    figures = traits.score_trait(whole, few, stddev)
    equivalent = traits.score_trait(
        numbers(rows, 'whole_equivalent', 'value'), numbers(rows, 'thinned_equivalent', 'value')
    )
    figures['equivalent_rmse'] = equivalent['rmse']
    figures['points'] = float(np.mean(numbers(rows, 'points'))) if rows else np.nan
    return figures


TABLES = {
    'monte_carlo': monte_carlo,
    'rivals': rivals,
    'fields': fields,
    'trunks': trunks,
    'real': real,
}
