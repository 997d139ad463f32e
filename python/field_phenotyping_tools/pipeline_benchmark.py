"""The tables of benchmark_pipeline.

Each takes a Bench and a folder for pictures, prints itself with a heading and returns figures.
"""

import collections
import os
import shutil
import statistics

import numpy as np

from .benchmarks import Report, cloud_of, figure, note_load, print_header, print_row, score

# What the pipeline is to reach. Seconds are of two cores, all others are ratios.
MOST_SECONDS = 2.0  # ripe field, 116 plants, 1.2 million points
MOST_OF_PCL = 0.3  # whole pipeline, of the normals and regions of the Point Cloud Library alone
LEAST_VOXEL_GRID = 3.0  # times faster, one core
LEAST_SOIL = 5.0
LEAST_TWO_CORES = 1.7  # times faster than one
MOST_TIME = 8.8  # times, for 8 times the field
MOST_MEMORY = 8.5
LEAST_CUDA = 20.0  # times faster than one core

# Table 4 of the paper [s]: RTX 4060, CPU. Its booting and milk ripening stages are the last two.
PAPER_SECONDS = collections.OrderedDict(
    [
        ('seedling', (2.15, 35.98)),
        ('jointing', (4.67, 90.15)),
        ('tasselling', (9.23, 197.85)),
        ('ripe', (18.62, 393.74)),
    ]
)

# A field, and how often each run is repeated.
Size = collections.namedtuple('Size', 'rows plants_per_row points repeats')
STANDARD = Size(4, 29, 1200000, 3)
QUICK = Size(2, 6, 120000, 1)
POINTS_A_PLANT = STANDARD.points // (STANDARD.rows * STANDARD.plants_per_row)
# Times the plants: rows, plants in each.
SHAPES = collections.OrderedDict([(1, (4, 15)), (2, (4, 30)), (4, (8, 30)), (8, (8, 60))])
QUICK_SHAPES = collections.OrderedDict([(1, (1, 4)), (8, (2, 16))])
POINTS = (100000, 1000000, 10000000)
POINTS_SHAPE = (2, 10)  # few plants: the simulation of ten million points takes long
QUICK_POINTS = (30000, 300000)

# Arithmetic that cannot be left out, additions and multiplications.
OPS_VOXEL = 16  # a point: scaled and rounded in x, y, z; its key scattered; its voxel's mean
OPS_DISTANCE = 8  # squared, and compared
OPS_PLANE = 4  # a point's height above a plane
OPS_PLANE_FIT = 18  # a soil point's share of the normal equations of a plane
OPS_BILINEAR = 10  # height of the soil below a point
OPS_MOMENTS = 18  # a neighbour's share of a covariance
CENTERS_NEAR = 28  # centres within three kernel widths of a place, one a width
OPS_KERNEL = 17  # a Gaussian at a place
OPS_FIT = 100  # a point's residual with its derivatives, and their products

MEGABYTE = 1e6


def field_settings(size, stage='ripe'):
    return (
        *('--stage', stage, '--rows', size.rows, '--plants-per-row', size.plants_per_row),
        *('--points', size.points),
    )


def _size(bench, size):
    return size or (QUICK if bench.quick else STANDARD)


def _heading(title, text):
    print('\n## {}\n\n{}'.format(title, text), flush=True)


def _picture(folder, name, what):
    path = os.path.join(folder, name)
    print('\n![{}]({})'.format(what, name), flush=True)
    return path


def _runs(count):
    """In words."""
    return 'one run' if count == 1 else '{} runs'.format(count)


def _text(name):
    return lambda row: str(row.get(name, '-'))


def _whole(name, scale=1.0):
    """A large number."""

    def text(row):
        value = row.get(name)
        return '-' if value is None else '{:,.0f}'.format(scale * value)

    return text


def preface(bench):
    """The machine, by what it is and not by its name."""
    machine = bench.json_rows('time_stages', 'machine')
    print('# Speed and memory\n')
    print(
        'Written by `benchmark_pipeline --report`{}; do not edit. {} core{}, {}; {}. One core copies '
        '{:.1f} GB/s (read and\nwritten together) and does {:.1f} billion single-precision additions '
        'and multiplications a second.'.format(
            ' in its quick form, whose figures mean little' if bench.quick else '',
            os.cpu_count(),
            '' if os.cpu_count() == 1 else 's',
            _processor(),
            machine['compiler'],
            1e-9 * machine['bytes_per_second'],
            1e-9 * machine['operations_per_second'],
        )
    )
    print(
        '\nFields are of `simulate_field`, seed {}. What is compared took turns, after a round that '
        'does not count; seconds\nare medians. Seconds of another machine will differ, ratios '
        'less.'.format(bench.seed),
        flush=True,
    )


def _processor():
    try:
        with open('/proc/cpuinfo') as file:
            for line in file:
                if line.startswith('model name'):
                    return ' '.join(line.split(':', 1)[1].split())
    except OSError:
        pass
    return 'processor not known'


def _median(row):
    return statistics.median(row['seconds'])


# ------------------------------------------------------------------------------------- Table 4


def stages(bench, folder, size=None, names=tuple(PAPER_SECONDS)):
    """Table 4 of the paper."""
    size = _size(bench, size)
    _heading(
        'Growth stages',
        'Table 4 of the paper, whose seconds are of its own fields, an i5-12400 and an RTX 4060: {} '
        'plants, whole pipeline from\nthe cloud in memory, {}. Plants and points are scored by the '
        'simulated truth. All devices are to give the same plants.'.format(
            size.rows * size.plants_per_row, _runs(size.repeats)
        ),
    )
    columns = (
        ('points', _whole('points')),
        ('plants found', _text('plants_of')),
        ('stem F1', figure('stem_f1', decimals=3)),
        ('IoU', figure('stem_iou', decimals=3)),
        ('height RMSE [cm]', figure('height_rmse', 100.0, 1)),
        ('diameter RMSE [mm]', figure('stem_diameter_rmse', 1000.0, 2)),
        ('seconds', figure('median_s')),
        ('times faster than one core', figure('speedup')),
        ('same plants', _text('same_plants')),
        ('the paper [s]', figure('paper_s')),
    )
    print_header('stage, on', columns)
    figures = {}
    for stage in names:
        bench.progress('stages: {}: simulating'.format(stage))
        field = bench.known_field(*field_settings(size, stage))
        bench.progress('stages: ' + stage)
        rows = _timed_runs(bench, field, size)
        for row in rows:
            label = '{}, {}'.format(stage, row.get('setting', 'CUDA'))
            on_gpu = row.get('gpu', True)
            if on_gpu or row is rows[0]:
                row['paper_s'] = PAPER_SECONDS[stage][0 if on_gpu else 1]
            figures[label] = row
            print_row(label, columns, row)
    if any('why_no_gpu' in row for row in figures.values()):
        print(
            '\nThe rows CUDA are empty: there is no GPU here. [Elsewhere](gpu.md) one was used.',
            flush=True,
        )
    note_load()
    from . import plots  # matplotlib takes a second to load

    path = _picture(folder, 'pipeline_stages.png', 'Seconds of each stage by growth stage')
    plots.pipeline_stages(path, {k: row for k, row in figures.items() if 'stages_s' in row})
    return figures


def _timed_runs(bench, field, size):
    """Rows of time_stages on a field, with scores; a row with `why_no_gpu` where there is none."""
    results = os.path.join(field, 'runs')
    rows = bench.json_rows(
        'time_stages', 'pipeline', cloud_of(field), '--results', results, '--repeats', size.repeats
    )
    scores = None
    for row in rows:
        if 'why_no_gpu' in row:
            continue
        if scores is None or not row['same']:
            own = score(row['run'], field)
        scores = scores or own
        row.update(scores if row['same'] else own)
        row['median_s'] = _median(row)
        row['speedup'] = rows[0]['median_s'] / row['median_s']
        row['stages_s'] = {name: statistics.median(s) for name, s in row['stages'].items()}
        row['plants_of'] = '{} of {}'.format(row['matched'], row['truth_plants'])
        row['same_plants'] = 'yes' if row['same'] else 'NO'
    shutil.rmtree(results)
    return rows


# ----------------------------------------------------------------- the Point Cloud Library's parts


def rivals(bench, folder, size=None, every_stem=4):
    """Stages beside the parts of the Point Cloud Library."""
    size = _size(bench, size)
    _heading(
        'Beside the Point Cloud Library',
        'What a user would take of it instead, on the same points of the ripe field, one core each '
        'if not said; {}.\nVoxels are of 3 mm. Soil: the same distance from the plane as our own '
        'RANSAC takes, the same steepest plane, 0.99\nconfidence, least squares at the end; ours '
        'also follows the soil from place to place and spares the feet of what\nstands on it. Normals '
        'of 50 neighbours and regions of 30, 3 deg, as in its tutorial. Moving least squares with\nthe '
        'settings that `benchmark_completion` finds best. Found are voxels, points of the soil, '
        'plants or regions, filled points.'.format(_runs(size.repeats)),
    )
    columns = (
        ('points', _whole('points')),
        ('found', _whole('found')),
        ('seconds', figure('median_s', decimals=3)),
        ('times as long as ours', figure('ratio')),
    )
    field = bench.known_field(*field_settings(size))
    bench.progress('rivals')
    timed = bench.json_rows(
        *('time_stages', 'rivals', cloud_of(field), '--repeats', size.repeats),
        *('--every-stem', every_stem),
    )
    figures = compare_stages(timed)
    print_header('stage, by', columns)
    for label, row in figures.items():
        print_row(label, columns, row)
    whole = figures['voxel grid, pcl::VoxelGrid, whole plot']
    unfiltered = whole['found'] == whole['points']
    if unfiltered:
        print(
            '\nOn the whole plot pcl::VoxelGrid hands all {:,} points back unfiltered, for its 32-bit '
            'index of a voxel would\noverflow; its warning is all that tells.'.format(whole['points'])
        )
    else:
        print('\nThis plot is small enough for the 32-bit index of pcl::VoxelGrid.')
    note_load()
    from . import plots

    path = _picture(folder, 'pipeline_rivals.png', 'The Point Cloud Library beside ours')
    worked = [label for label in figures if not (unfiltered and figures[label] is whole)]
    plots.pipeline_rivals(path, {label: figures[label] for label in worked})
    return figures


def compare_stages(timed):
    """{stage, method: figures} of the rows of `time_stages rivals`, in the order of the pipeline."""
    seconds = {(row['stage'], row['method']): _median(row) for row in timed}
    figures = collections.OrderedDict()

    def add(stage, row, median):
        label = '{}, {}'.format(stage, row['method'])
        figures[label] = dict(row, median_s=median)

    for stage in ('voxel grid', 'soil', 'segmentation', 'completion', 'whole pipeline'):
        rows = [row for row in timed if row['stage'] == stage]
        rows.sort(key=lambda row: not row['method'].startswith('ours'))
        growing = {}
        for row in rows:
            if row['method'].startswith('pcl::RegionGrowing'):
                growing[row['method'].split(', ')[1]] = row
        for row in rows:
            method = row['method']
            if method.startswith('pcl::RegionGrowing'):
                continue
            if not method.startswith('pcl::NormalEstimationOMP'):
                add(stage, row, seconds[stage, method])
                continue
            _, points, cores = method.split(', ')
            regions = growing[points]
            add(
                stage,
                dict(
                    regions,
                    method='pcl::NormalEstimationOMP ({}) + RegionGrowing, {}'.format(cores, points),
                ),
                seconds[stage, method] + seconds[stage, regions['method']],
            )
        ours = next((f['median_s'] for f in figures.values() if f['stage'] == stage), None)
        for row in figures.values():
            if row['stage'] == stage:
                row['ratio'] = row['median_s'] / ours
    return figures


# ------------------------------------------------------------------------------------- scaling


def plants(bench, folder, shapes=None, repeats=None):
    """1 to 8 times the field."""
    shapes = shapes or (QUICK_SHAPES if bench.quick else SHAPES)
    repeats = repeats or _size(bench, None).repeats
    _heading(
        'Larger fields',
        'Ripe, {:,} points a plant, all cores, {}. Memory is the most that a run like that of '
        '`phenotype_cloud` holds, with the\nfile that it has read, each in a process of its own; '
        'without what that holds before, which is libraries.'.format(POINTS_A_PLANT, _runs(repeats)),
    )
    sizes = {
        times: Size(rows, in_each, POINTS_A_PLANT * rows * in_each, repeats)
        for times, (rows, in_each) in shapes.items()
    }
    columns = (
        ('plants', _text('plants')),
        ('points', _whole('points')),
        ('seconds', figure('median_s')),
        ("of the small field's", figure('time_ratio')),
        ('most memory [MB]', _whole('bytes', 1.0 / MEGABYTE)),
        ("of the small field's", figure('memory_ratio')),
    )
    figures = {
        '{} x'.format(times): row
        for times, row in zip(sizes, _scaled(bench, 'plants', sizes.values(), repeats))
    }
    first = figures['1 x']
    print_header('field', columns)
    for label, row in figures.items():
        row['time_ratio'] = row['median_s'] / first['median_s']
        row['memory_ratio'] = row['bytes'] / first['bytes']
        print_row(label, columns, row)
    print_row(
        'goal for 8 x, at most', columns, {'time_ratio': MOST_TIME, 'memory_ratio': MOST_MEMORY}
    )
    note_load()
    from . import plots

    path = _picture(folder, 'pipeline_plants.png', 'Seconds and memory by the size of the field')
    plots.pipeline_scaling(path, figures, 'the field')
    return figures


def points(bench, folder, counts=None, repeats=None, shape=None):
    """The same plants with ever more points."""
    counts = counts or (QUICK_POINTS if bench.quick else POINTS)
    repeats = repeats or _size(bench, None).repeats
    rows_of, in_each = shape or (QUICK_SHAPES[1] if bench.quick else POINTS_SHAPE)
    _heading(
        'More points on the same plants',
        'A ripe field of {} plants, all cores, {}; memory as above. A voxel takes many points to '
        'one, so that time follows\nthe voxels; where more than `max_density` of them lie on a '
        'square metre the block is thinned.'.format(rows_of * in_each, _runs(repeats)),
    )
    columns = (
        ('plants found', _text('plants')),
        ('seconds', figure('median_s')),
        ('microseconds a point', figure('point_us')),
        ('most memory [MB]', _whole('bytes', 1.0 / MEGABYTE)),
        ('bytes a point', _whole('point_bytes')),
    )
    sizes = [Size(rows_of, in_each, count, repeats) for count in counts]
    figures = {}
    print_header('points', columns)
    for count, row in zip(counts, _scaled(bench, 'points', sizes, repeats)):
        row['point_us'] = 1e6 * row['median_s'] / row['points']
        row['point_bytes'] = row['bytes'] / row['points']
        figures[str(count)] = row
        print_row('{:,}'.format(count), columns, row)
    note_load()
    from . import plots

    path = _picture(folder, 'pipeline_points.png', 'Seconds and memory by the number of points')
    plots.pipeline_scaling(path, figures, '')
    return figures


def _scaled(bench, name, sizes, repeats):
    """Seconds of all fields, in turn, and memory of each."""
    clouds = []
    for size in sizes:
        bench.progress('{}: simulating {:,} points'.format(name, size.points))
        clouds.append(cloud_of(bench.known_field(*field_settings(size))))
    bench.progress('{}: seconds'.format(name))
    rows = bench.json_rows(
        'time_stages', 'pipeline', *clouds, '--threads', 0, '--repeats', repeats
    )
    rows = [row for row in rows if 'cloud' in row]
    for row, cloud in zip(rows, clouds):
        bench.progress('{}: memory of {:,} points'.format(name, row['points']))
        row.update(bench.json_rows('time_stages', 'memory', cloud))
        row['bytes'] = row['whole pipeline'] - row['empty']
        row['median_s'] = _median(row)
    return rows


def cores(bench, folder, size=None, most=None):
    """One core to all of them."""
    size = _size(bench, size)
    most = most or os.cpu_count()
    counts = [1]
    while 2 * counts[-1] < most:
        counts.append(2 * counts[-1])
    if most > 1:
        counts.append(most)
    _heading('Cores', 'The ripe field, whole pipeline, {}.'.format(_runs(size.repeats)))
    columns = (
        ('seconds', figure('median_s')),
        ('times faster than one', figure('speedup')),
        ('of what cores could give', figure('efficiency')),
    )
    field = bench.known_field(*field_settings(size))
    bench.progress('cores')
    threads = [word for count in counts for word in ('--threads', count)]
    rows = bench.json_rows(
        'time_stages', 'pipeline', cloud_of(field), *threads, '--repeats', size.repeats
    )
    figures = {}
    print_header('cores', columns)
    for count, row in zip(counts, rows):
        row['median_s'] = _median(row)
        row['speedup'] = rows[0]['median_s'] / row['median_s']
        row['efficiency'] = row['speedup'] / count
        figures[str(count)] = row
        print_row(str(count), columns, row)
    print_row('goal for 2, at least', columns, {'speedup': LEAST_TWO_CORES})
    note_load()
    return figures


def memory(bench, folder, size=None):
    """Most memory after each step."""
    size = _size(bench, size)
    _heading(
        'Memory',
        'Most that a process like `phenotype_cloud` has held until each step was done, ripe field, '
        'all cores.',
    )
    field = bench.known_field(*field_settings(size))
    bench.progress('memory')
    row = bench.json_rows('time_stages', 'memory', cloud_of(field))
    steps = (
        ('the program has started', 'empty'),
        ('cloud read', 'reading'),
        ('voxel grid filled', 'voxel grid'),
        ('all blocks segmented', 'segmentation'),
        ('completed and measured', 'measurement'),
        ('every point labelled', 'whole pipeline'),
    )
    columns = (
        ('most memory [MB]', _whole('bytes', 1.0 / MEGABYTE)),
        ('bytes an input point', _whole('point_bytes')),
    )
    print_header('until', columns)
    figures = {}
    for label, name in steps:
        figures[label] = {'bytes': row[name], 'point_bytes': row[name] / row['points']}
        print_row(label, columns, figures[label])
    return figures


# ------------------------------------------------------------------------------------- floors


def least_work(work):
    """{stage: (bytes that must move, operations that must be done)} of what countWork() counted."""
    n, m = work['points'], work['voxels']
    soil, plant, stem = work['soil_points'], work['plant_points'], work['stem_points']
    filled, fitted = work['filled_points'], work['diameter_points']
    place, flag, label, voxel, filled_point = 12, 1, 5, 16, 16  # bytes
    tests = work['min_neighbors'] + 1
    return collections.OrderedDict(
        [
            ('voxel grid', (place * n + voxel * m, OPS_VOXEL * n)),
            ('outliers', ((place + flag) * m, OPS_DISTANCE * tests * m)),
            (
                'soil',
                (
                    (place + flag) * (soil + plant),
                    (OPS_PLANE + OPS_BILINEAR) * (soil + plant) + OPS_PLANE_FIT * soil,
                ),
            ),
            (
                'segmentation',
                ((place + label) * plant, (OPS_DISTANCE + OPS_MOMENTS) * work['neighbours']),
            ),
            (
                'completion',
                (2 * place * stem + filled_point * filled, CENTERS_NEAR * OPS_KERNEL * filled),
            ),
            ('measurement', (place * fitted, OPS_FIT * fitted)),
        ]
    )


def floors(bench, folder, size=None):
    """What must be done at least beside the seconds that it takes."""
    size = _size(bench, size)
    _heading(
        'Floors',
        'What each stage cannot do without on the ripe field, one core, {}, beside how long the '
        'machine, measured just before,\nwould take for it: bytes that must be read and written once, and '
        'additions and multiplications. Counted from the\nscene:\n\n'
        '- voxel grid: every input point is read (12 bytes) and every voxel written (16); {} '
        'operations a point for its voxel\n  and that one\'s mean;\n'
        '- outliers: every voxel is read and gets a flag (13 bytes), after as many distances as it '
        'needs neighbours, itself\n  included ({} operations each);\n'
        '- soil: every point that is left is read and gets a flag; its height above a plane and the '
        'local soil ({}), and of soil\n  points a share of a plane\'s normal equations ({});\n'
        '- segmentation: every point above the soil is read and gets a plant and an organ (17 bytes); '
        'one distance and a share\n  of a covariance ({}) for each of its neighbours within '
        '`seed_radius`, which is its normal and curvature (2.4.1);\n'
        '- completion: stem points are read and written smoothed (24 bytes), filled points written '
        'with their standard\n  deviation (16); at each of those the {} Gaussians within three '
        'kernel widths ({});\n'
        '- measurement: points that a diameter is fitted to are read (12 bytes); one step of a '
        'fit, {} operations a point.\n\n'
        'The floor is the longer of the two. Growth, merging, assignment of leaves, and the many '
        'steps of a robust fit are not\nin it.'.format(
            _runs(size.repeats),
            OPS_VOXEL,
            OPS_DISTANCE,
            OPS_PLANE + OPS_BILINEAR,
            OPS_PLANE_FIT,
            OPS_DISTANCE + OPS_MOMENTS,
            CENTERS_NEAR,
            CENTERS_NEAR * OPS_KERNEL,
            OPS_FIT,
        ),
    )
    field = bench.known_field(*field_settings(size))
    bench.progress('floors')
    machine = bench.json_rows('time_stages', 'machine')
    work = bench.json_rows('time_stages', 'floors', cloud_of(field), '--repeats', size.repeats)
    figures = collections.OrderedDict()
    for stage, (moved, operations) in least_work(work).items():
        figures[stage] = {
            'bytes': moved,
            'operations': operations,
            'bytes_s': moved / machine['bytes_per_second'],
            'operations_s': operations / machine['operations_per_second'],
            'median_s': statistics.median(work['seconds'][stage]),
        }
    figures['all'] = {
        name: sum(row[name] for row in figures.values())
        for name in ('bytes', 'operations', 'bytes_s', 'operations_s', 'median_s')
    }
    columns = (
        ('bytes [MB]', _whole('bytes', 1.0 / MEGABYTE)),
        ('operations [million]', _whole('operations', 1e-6)),
        ('bytes take [s]', figure('bytes_s', decimals=4)),
        ('operations take [s]', figure('operations_s', decimals=4)),
        ('measured [s]', figure('median_s', decimals=3)),
        ('measured / floor', figure('of_floor', decimals=1)),
    )
    print_header('stage', columns)
    for stage, row in figures.items():
        floor = max(row['bytes_s'], row['operations_s'])
        row['of_floor'] = row['median_s'] / floor if floor > 0.0 else float('nan')
        print_row(stage, columns, row)
    print(
        '\n{:,} points in {:,} voxels, {:,} of them above the soil with {:.0f} neighbours each; {} '
        'plants with {:,} stem points\nand {:,} filled ones. One core copied {:.1f} GB/s and did {:.1f} '
        'billion operations a second.'.format(
            work['points'],
            work['voxels'],
            work['plant_points'],
            work['neighbours'] / max(1, work['plant_points']),
            work['plants'],
            work['stem_points'],
            work['filled_points'],
            1e-9 * machine['bytes_per_second'],
            1e-9 * machine['operations_per_second'],
        )
    )
    note_load()
    return dict(figures)


# ------------------------------------------------------------------------------------- callgrind


FUNCTIONS = collections.OrderedDict(
    [
        ('whole pipeline', 'field_phenotyping::phenotypeCloud'),
        ('voxel grid (`addScan`)', 'field_phenotyping::Preprocessor::addScan'),
        ('outliers and soil (`finishBlock`)', 'field_phenotyping::finishBlock'),
        ('segmentation (`segmentBlock`)', 'field_phenotyping::segmentBlock'),
        ('completion (`completeBlock`)', 'field_phenotyping::completeBlock'),
        ('measurement (`measureBlock`)', 'field_phenotyping::measureBlock'),
    ]
)


def instructions(bench, folder, size=None):
    """Instructions of the whole pipeline, under callgrind."""
    size = _size(bench, size)
    _heading(
        'Instructions',
        'Of the ripe field, one thread, counted by callgrind: the same compiler and settings give '
        'the same number to some\nparts in a million, so that versions can be compared where seconds '
        'differ by less than noise.',
    )
    if shutil.which('valgrind') is None:
        print('\nSKIPPED instructions: valgrind is not installed (apt install valgrind).')
        return {}
    field = bench.known_field(*field_settings(size))
    bench.progress('instructions')
    counts = bench.count_instructions(cloud_of(field))
    whole = counts[FUNCTIONS['whole pipeline']]
    columns = (
        ('instructions [million]', figure('instructions', 1e-6, 1)),
        ('share', figure('share', decimals=3)),
        ('a point', _whole('per_point')),
    )
    figures = {}
    print_header('step', columns)
    for label, name in FUNCTIONS.items():
        count = counts.get(name, float('nan'))
        figures[label] = {
            'instructions': count,
            'share': count / whole,
            'per_point': count / size.points,
        }
        print_row(label, columns, figures[label])
    return figures


# ------------------------------------------------------------------------------------- goals


def closing(figures):
    """Each goal beside what was reached, of the tables that were printed."""
    rows = goals(figures)
    if not rows:
        return
    _heading('Goals', 'Of two cores where it says so.')
    print_header('', (('goal', None), ('figure', None), ('reached', None)))
    for title, goal, value, reached in rows:
        print('| {} | {} | {} | {} |'.format(title, goal, value, 'yes' if reached else 'no'))


def goals(figures):
    """[(what, goal, figure, whether it is reached)], as far as the figures are there."""
    rows = []

    def at_most(title, goal, value, unit):
        if value is not None:
            rows.append((title, '≤ {} {}'.format(goal, unit), _with(value, unit), value <= goal))

    def at_least(title, goal, value, unit='x'):
        if value is not None:
            rows.append((title, '≥ {} {}'.format(goal, unit), _with(value, unit), value >= goal))

    table4 = figures.get('stages', {})
    all_cores = table4.get('ripe, all cores', {})
    at_most(
        'ripe field, {:,} points, all cores'.format(all_cores.get('points', 0)),
        MOST_SECONDS,
        all_cores.get('median_s'),
        's',
    )
    beside = figures.get('rivals', {})
    one = beside.get('whole pipeline, ours, one core', {}).get('median_s')
    for points_given in ('whole cloud', 'above the soil'):
        label = 'segmentation, pcl::NormalEstimationOMP (one core) + RegionGrowing, ' + points_given
        regions = beside.get(label, {}).get('median_s')
        at_most(
            'whole pipeline, one core, of PCL normals + RegionGrowing alone, ' + points_given,
            MOST_OF_PCL,
            one / regions if one and regions else None,
            'x',
        )
    at_least(
        'voxel grid, faster than pcl::VoxelGrid, one core',
        LEAST_VOXEL_GRID,
        beside.get('voxel grid, pcl::VoxelGrid, tile by tile', {}).get('ratio'),
    )
    at_least(
        'soil, faster than pcl::SACSegmentation, one core',
        LEAST_SOIL,
        beside.get('soil, pcl::SACSegmentation', {}).get('ratio'),
    )
    at_least(
        'two cores against one',
        LEAST_TWO_CORES,
        figures.get('cores', {}).get('2', {}).get('speedup'),
    )
    eight = figures.get('plants', {}).get('8 x', {})
    at_most('8 x the field, time', MOST_TIME, eight.get('time_ratio'), 'x')
    at_most('8 x the field, memory', MOST_MEMORY, eight.get('memory_ratio'), 'x')
    gpu = [row for label, row in table4.items() if label.startswith('ripe') and row.get('gpu')]
    if gpu:
        best = min(gpu, key=_plant_work)
        at_least(
            'CUDA against one core, segmentation to measurement',
            LEAST_CUDA,
            _plant_work(table4['ripe, one core']) / _plant_work(best),
        )
    elif table4:
        rows.append(
            ('CUDA against one core', '≥ {} x'.format(LEAST_CUDA), 'no GPU here', False)
        )
    return rows


def _plant_work(row):
    return sum(row['stages_s'][stage] for stage in ('segmentation', 'completion', 'measurement'))


def _with(value, unit):
    return '{:.2f} {}'.format(value, unit) if np.isfinite(value) else '-'


TABLES = {
    'stages': stages,
    'rivals': rivals,
    'plants': plants,
    'points': points,
    'cores': cores,
    'memory': memory,
    'floors': floors,
    'instructions': instructions,
}
REPORT = Report(preface, closing)
