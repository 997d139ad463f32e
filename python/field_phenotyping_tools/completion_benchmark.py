"""The tables of benchmark_completion.

Each takes a Bench and a folder for pictures, prints itself row by row and returns {row: figures}.
"""

import collections
import math
import os

from .benchmarks import figure, note_load, print_header, print_row, real_data

# What completion is to reach with its defaults, at 3 mm noise and gaps to 20 cm.
GOALS = {
    'pc': 0.95,
    'sm': 0.97,
    'rd': 0.91,
    'rmse': 1.5e-3,
    'coverage': '0.90 - 0.99',
}
SECONDS = {600: 5e-3, 10000: 20e-3}  # points of a stem: seconds of one core, at most
# Tables 2 and 6 of the paper, on its own data and computer.
PAPER_BEFORE = {'pc': 0.73, 'sm': 0.86, 'rd': 0.69}
PAPER_METHODS = {
    'ours': {'pc': 0.95, 'sm': 0.97, 'rd': 0.91, 'seconds': 3.24},
    'MLS': {'pc': 0.91, 'sm': 0.91, 'rd': 0.87, 'seconds': 5.67},
    'kNN': {'pc': 0.88, 'sm': 0.91, 'rd': 0.92, 'seconds': 4.33},
    'VGC': {'pc': 0.78, 'sm': 0.82, 'rd': 0.87, 'seconds': 2.98},
    'NNI': {'pc': 0.89, 'sm': 0.93, 'rd': 0.86, 'seconds': 4.19},
}
REAL_CLOUDS = (
    'maizefield3d_T8',
    'maizefield3d_A679',
    'maizefield3d_78551S',
    'label3dmaize_v-12-1',
    'label3dmaize_v-9-3',
    'mospc_mid_1',
    'mospc_small_1',
)

_QUALITY = (('pc', 'PC'), ('sm', 'SM'), ('rd', 'RD'))
_TIMES = (600, 2000, 10000, 100000)


def summarise(rows):
    """Figures of the rows of complete_stems: means, and errors over the filled points of all."""
    judged = sum(row.get('judged', 0) for row in rows)
    squares = sum(row.get('squares_m2', 0.0) for row in rows)
    figures = {name: _mean(row[name] for row in rows) for name, _ in _QUALITY}
    figures['stems'] = len(rows)
    figures['points'] = _mean(row['points'] for row in rows)
    figures['filled'] = _mean(row.get('filled', 0) for row in rows)
    figures['seconds'] = _mean(row.get('seconds', 0.0) for row in rows)
    figures['deepest'] = max([row.get('deepest_m', 0.0) for row in rows] or [0.0])
    figures['empty'] = sum(row.get('filled', 0) == 0 for row in rows)
    figures['flagged'] = sum(bool(row.get('flags')) for row in rows)
    if judged:
        figures['rmse'] = math.sqrt(squares / judged)
        figures['bias'] = sum(row.get('sum_m', 0.0) for row in rows) / judged
        figures['worst_rmse'] = max(
            math.sqrt(row['squares_m2'] / row['judged']) for row in rows if row.get('judged')
        )
        if all('covered' in row for row in rows if row.get('judged')):
            figures['coverage'] = sum(row.get('covered', 0) for row in rows) / judged
    return figures


def _mean(values):
    values = list(values)
    return sum(values) / len(values) if values else float('nan')


def complete(bench, *settings):
    """Rows of a run of complete_stems."""
    return bench.json_rows('complete_stems', '--seed', bench.seed, *settings)


def by_damage(rows, method):
    """{damage: rows} of one method, in the order of the rows; under 'all' all of them."""
    groups = collections.OrderedDict()
    for row in rows:
        if row['method'] == method:
            groups.setdefault(row['damage'], []).append(row)
    groups['all'] = [row for group in groups.values() for row in group]
    return groups


def _before_and_after(rows):
    """{damage: figures} with the figures before as `before_pc` and so on."""
    before = {name: summarise(group) for name, group in by_damage(rows, 'before').items()}
    figures = {name: summarise(group) for name, group in by_damage(rows, 'ours').items()}
    for name, row in figures.items():
        row.update({'before_' + key: before[name][key] for key, _ in _QUALITY})
    return figures


def _change(name):
    before, after = figure('before_' + name, decimals=3), figure(name, decimals=3)
    return lambda row: '{} -> {}'.format(before(row), after(row))


_GAP_COLUMNS = (
    ('points', figure('points', decimals=0)),
    ('filled', figure('filled', decimals=0)),
) + tuple((title, _change(name)) for name, title in _QUALITY) + (
    ('RMSE to the true surface [mm]', figure('rmse', 1e3)),
    ('worst stem [mm]', figure('worst_rmse', 1e3)),
    ('bias [mm]', figure('bias', 1e3)),
    ('coverage', figure('coverage', decimals=3)),
    ('one core [ms]', figure('seconds', 1e3, 1)),
)


def _print_gaps(title, rows):
    figures = _before_and_after(rows)
    print_header(title, _GAP_COLUMNS)
    goal = dict(GOALS, before_pc=None, before_sm=None, before_rd=None)
    print_row(
        'goal, at least (RMSE: at most)',
        tuple((t, _text_or(text, goal, t)) for t, text in _GAP_COLUMNS),
        goal,
    )
    for name, row in figures.items():
        print_row(name, _GAP_COLUMNS, row)
    return figures


def _text_or(text, goal, title):
    if title == 'coverage':
        return lambda row: goal['coverage']
    return text


def gaps(bench, folder, stems=12, points=600):
    """Table 2 of the paper: before and after, on simulated stems."""
    bench.progress('gaps')
    rows = complete(bench, '--stems', stems, '--points', points)
    figures = _print_gaps('{} simulated stems of {} points, noise 3 mm'.format(stems, points), rows)
    print_row(
        'paper, its own data',
        _GAP_COLUMNS,
        dict(PAPER_METHODS['ours'], **{'before_' + k: v for k, v in PAPER_BEFORE.items()}, seconds=None),
    )
    from . import plots  # matplotlib takes a second to load

    path = os.path.join(folder, 'completion_gaps.png')
    plots.completion_gaps(path, figures, GOALS)
    print('\nWrote {}'.format(path), flush=True)
    return figures


def rivals(bench, _folder, stems=6, points=600, damages=()):
    """Table 6 of the paper: four other methods on the same stems, ranks in brackets.

    damages: kinds of gaps; all where empty.
    """
    bench.progress('rivals')
    only = [word for damage in damages for word in ('--damage', damage)]
    rows = complete(bench, '--stems', stems, '--points', points, '--rivals', *only)
    return _print_methods(
        '{} simulated stems of {} points, all gaps'.format(stems, points), rows, paper=True
    )


def best_settings(rows):
    """{method: (settings, figures)}: of each method the settings with the highest score, which is
    PC + SM + RD less a tenth for every goal's worth of RMSE."""
    groups = collections.OrderedDict()
    for row in rows:
        if row['method'] != 'before':
            groups.setdefault((row['method'], row['settings']), []).append(row)
    best = collections.OrderedDict()
    for (method, settings), group in groups.items():
        figures = summarise(group)
        score = sum(figures[name] for name, _ in _QUALITY)
        score -= figures.get('rmse', 1.0) / (10.0 * GOALS['rmse'])
        if method not in best or score > best[method][2]:
            best[method] = (settings, figures, score)
    return {method: (settings, figures) for method, (settings, figures, _) in best.items()}


def ranks(figures_of, name, least_first=False):
    """{method: rank by a figure}, 1 is best."""
    values = {
        method: figures.get(name, float('inf') if least_first else -1.0)
        for method, figures in figures_of.items()
    }
    order = sorted(values.values(), reverse=not least_first)
    return {method: 1 + order.index(value) for method, value in values.items()}


def _print_methods(title, rows, paper=False):
    best = best_settings(rows)
    figures_of = {method: figures for method, (_, figures) in best.items()}
    for name, least_first in (
        ('pc', False), ('sm', False), ('rd', False), ('rmse', True), ('seconds', True),
    ):  # fmt: skip
        for method, rank in ranks(figures_of, name, least_first).items():
            figures_of[method]['rank_' + name] = rank

    def ranked(name, scale=1.0, decimals=3):
        text = figure(name, scale, decimals)
        return lambda row: '{} ({})'.format(text(row), row.get('rank_' + name, '-'))

    columns = tuple((title, ranked(name)) for name, title in _QUALITY) + (
        ('RMSE [mm]', ranked('rmse', 1e3, 2)),
        ('one core [ms]', ranked('seconds', 1e3, 1)),
        ('filled', figure('filled', decimals=0)),
    )
    print_header(title + '; method (rank)', columns)
    for method, (settings, figures) in best.items():
        print_row('{}, {}'.format(method, settings), columns, figures)
    if paper:
        for method, figures in PAPER_METHODS.items():
            print_row(method + ', the paper\'s figures', columns, figures)
    note_load()
    return figures_of


def real(bench, _folder, clouds=REAL_CLOUDS, rivals=True):
    """Real stems with pieces cut out.

    Filled points are judged where points were cut out, by a plane through the points that were
    there, whose own standard deviation counts in the coverage.
    """
    data = real_data()
    if data is None:
        return {}
    paths = [os.path.join(data, name + '.pcd') for name in clouds]
    bench.progress('real')
    only = ['--rivals'] if rivals else []
    rows = complete(bench, '--repeats', 1 if not rivals else 5, *only, '--real', *paths)
    figures = _print_gaps('{} real stems with pieces cut out'.format(len(clouds)), rows)
    if not rivals:
        return {'gaps': figures}
    return {'gaps': figures, 'methods': _print_methods('the same real stems, all gaps', rows)}


def odd(bench, _folder, stems=12):
    """Stems that can hardly be completed, or not at all."""
    bench.progress('odd')
    rows = complete(bench, '--odd', '--stems', stems)
    figures = _before_and_after(rows)
    del figures['all']
    columns = _GAP_COLUMNS + (
        ('left alone, of {}'.format(stems), figure('empty', decimals=0)),
        ('flagged', figure('flagged', decimals=0)),
        ('deepest below the soil [mm]', figure('deepest', 1e3, 1)),
    )
    print_header('odd stems, noise 3 mm', columns)
    for name, row in figures.items():
        print_row(name, columns, row)
    return figures


def scaling(bench, _folder, points=_TIMES, stems=6):
    """Seconds by points of a stem."""
    columns = (
        ('one core [ms]', figure('seconds', 1e3, 1)),
        ('goal [ms]', figure('goal_seconds', 1e3, 0)),
        ('filled', figure('filled', decimals=0)),
        ('RMSE [mm]', figure('rmse', 1e3)),
        ('coverage', figure('coverage', decimals=3)),
        ('SM', figure('sm', decimals=3)),
        ('RD', figure('rd', decimals=3)),
    )
    print_header('points of a stem, gap of 20 cm', columns)
    figures = {}
    for count in points:
        bench.progress('scaling: {} points'.format(count))
        rows = complete(bench, '--stems', stems, '--points', count, '--damage', 'gap 20 cm')
        figures[count] = summarise(by_damage(rows, 'ours')['all'])
        figures[count]['goal_seconds'] = SECONDS.get(count)
        print_row(str(count), columns, figures[count])
    note_load()
    return figures


TABLES = {'gaps': gaps, 'rivals': rivals, 'real': real, 'odd': odd, 'scaling': scaling}
