"""The tables of benchmark_live.

Each takes a Bench and a folder for pictures, prints itself and returns {row: figures}.
"""

import json
import os
import re
import sqlite3

import numpy as np

from . import evaluation, matching, tables, traits
from .benchmarks import figure, note_load, print_header, print_row

TRAITS = ('height', 'stem_diameter')
COVERAGE = '0.90 - 0.99'
REPLAY_GOAL = 5.0  # times real time, 300,000 points/s
SAME_HEIGHT = 1e-2  # [m] of a plant, from the scans and from the merged cloud
SAME_DIAMETER = 0.5e-3  # [m]
# (label, settings of simulate_field): a drive of half a minute, and one as fast as rovers go
LOADS = (
    ('4 rows, 0.8 m/s', ('--plants-per-row', '50', '--lane-every', '2', '--speed', '0.8')),
    ('4 rows, 1.5 m/s', ('--plants-per-row', '90', '--lane-every', '2', '--speed', '1.5')),
)
# A straight lane with few points, so that hours of it are replayed in minutes.
LONG_LANE = (
    *('--rows', '2', '--plants-per-row', '60', '--lane-every', '99', '--speed', '0.5'),
    *('--points', '0', '--point-rate', '15000', '--max-range', '4', '--sway', '0'),
    *('--roughness', '0', '--stage', 'jointing'),
)
FEW_PLANTS = 20  # say nothing of standard deviations
LONG_DRIVE = 7200.0  # [s]
SETTLED = 300.0  # [s] after which memory must not grow


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


def _median(values):
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    return float(np.median(known)) if known.size else float('nan')


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
    if np.sum(both) < FEW_PLANTS:  # where the map stays, both sides are one pass of a block in sight
        both = np.zeros_like(both)
    for trait in TRAITS:
        value, stddev = run.trait(trait)[ours][both], run.trait(trait + '_stddev')[ours][both]
        scores = traits.score_trait(truth[trait][theirs][both], value, stddev)
        one = [single[plant][-1][trait][1] for plant in run.ids[ours][both]]
        figures[trait + '_coverage'] = scores['coverage']
        figures[trait + '_rmse'] = scores['rmse']
        figures[trait + '_stddev_fused'] = _median(stddev)
        figures[trait + '_stddev_one'] = _median(one)
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


def load_table(bench, _):
    """300,000 pulses a second, 16 beams at 10 Hz: speed at full rate, latencies at the drive's own."""
    columns = [
        ('returns/s', figure('returns', decimals=0)),
        ('scans', figure('scans', decimals=0)),
        ('dropped', figure('dropped', decimals=0)),
        ('x real time, to the last scan', figure('times_scan', decimals=1)),
        ('to the last plant', figure('times_plant', decimals=1)),
        ('work on a scan, 99 % [ms]', figure('scan_work', 1e3, 0)),
        ('scan placed after its arrival, 99 % [ms]', figure('scan_placed', 1e3, 0)),
        ('first values after the block is due, median [s]', figure('first_median', decimals=2)),
        ('99 % [s]', figure('first', decimals=2)),
        ('last values after the block is final, median [s]', figure('last_median', decimals=2)),
        ('99 % [s]', figure('last', decimals=2)),
        ('memory [MB]', figure('memory', decimals=0)),
    ]
    print_header('drive', columns)
    print('| goal | 300000 | - | 0 | - | {:.1f} | 50 | - | - | 1.00 | - | - | - |'.format(REPLAY_GOAL))
    rows = {}
    for label, settings in LOADS:
        bench.progress('300,000 pulses/s, ' + label)
        field = bench.drive('--points', '0', *settings)
        bag = os.path.join(field, 'field.bag')
        totals = _settings(field)['totals']
        _, fast = bench.watched_replay(bag)
        _, live = bench.watched_replay(bag, 'rate:=1')
        figures = {
            'returns': totals['points'] / totals['duration_s'],
            'scans': totals['scans'],
            'times_scan': played_speed(fast.said, 'all scans are placed'),
            'times_plant': played_speed(fast.said, 'all is worked'),
        }
        newest = {
            stage: values[-1][1] for stage, values in live.diagnostics().items() if values
        }
        scans, plants = newest['preprocessing'], newest['measurement']
        figures['dropped'] = sum(
            value for name, value in scans.items() if name.startswith('scans dropped')
        )
        figures['scan_work'] = scans.get('work on a scan, 99 % [s]')
        figures['scan_placed'] = scans.get('scan, from its arrival until it is placed, 99 % [s]')
        first = 'plant, from when its block is due until its first values, '
        figures['first_median'] = plants.get(first + 'median [s]')
        figures['first'] = plants.get(first + '99 % [s]')
        last = 'block, from when it is final until its last values, '
        figures['last_median'] = plants.get(last + 'median [s]')
        figures['last'] = plants.get(last + '99 % [s]')
        figures['memory'] = max(memory_over_time(live.diagnostics())[1])
        rows[label] = figures
        print_row(label, columns, figures)
    note_load()
    return rows


def played_speed(said, stage):
    """Times real time that the player had reached when it said that."""
    found = re.search(r'in \S+ s, (\S+) x real time: ' + stage, said)
    return float(found.group(1)) if found else np.nan


def memory_over_time(diagnostics):
    """(ROS times [s], resident memory of the manager [MB])"""
    samples = [
        (time, values['memory of the process [MB]'])
        for time, values in diagnostics['preprocessing']
        if 'memory of the process [MB]' in values
    ]
    return np.array([time for time, _ in samples]), np.array([value for _, value in samples])


def settled_line(since, memory):
    """Memory after SETTLED and at the end of the drive [MB], on the line through all samples between.

    Single ones tell little: blocks come and go, and free memory goes back only now and then. After
    the drive's end its clock stands still.
    """
    between = (since >= SETTLED) & (since < since[-1])
    slope, offset = np.polyfit(since[between], memory[between], 1)
    return float(offset + slope * SETTLED), float(offset + slope * since[-1])


def ids_of_one_place(run, journal, radius=0.05):
    """Pairs of ids whose plants lie within `radius` [m] and were never reported together.

    Two that are in one report are two stems that the segmentation saw at once, be they or not.
    """
    with sqlite3.connect(journal) as database:
        rows = database.execute('SELECT plant_id, report FROM plant').fetchall()
    reports = {}
    for plant, report in rows:
        reports.setdefault(plant, set()).add(report)
    pairs = matching.close_pairs(run.bases[:, :2], radius)
    ids = [(int(run.ids[i]), int(run.ids[j])) for i, j in pairs]
    return [(a, b) for a, b in ids if not reports.get(a, set()) & reports.get(b, set())]


def memory_table(bench, _):
    """One lane driven on and on: resident memory, and whether each plant has one id."""
    columns = [
        ('minutes', figure('minutes', decimals=0)),
        ('km', figure('km', decimals=1)),
        ('plants', figure('plants', decimals=0)),
        ('with two ids', figure('duplicates', decimals=0)),
        ('memory after 5 min [MB]', figure('memory_early', decimals=1)),
        ('at the end', figure('memory_late', decimals=1)),
        ('growth', figure('growth', decimals=3)),
        ('bytes a plant', figure('bytes_per_plant', decimals=0)),
        ('x real time', figure('times', decimals=0)),
    ]
    print_header('drive', columns)
    print('| goal | 120 | - | - | 0 | - | - | 0.020 | - | - |')
    field = bench.drive(*LONG_LANE)
    path = os.path.join(field, 'trajectory.csv')
    drive = tables.read_table(path, ('time', 'x', 'y'))
    # The lane is straight and driven evenly; the bag's last transforms are a little later than its
    # last scan.
    lasted = drive['time'][-1] - drive['time'][0]
    period = lasted + 1.0
    step = (drive['x'][-1] - drive['x'][0]) * period / lasted
    loops = int(np.ceil(LONG_DRIVE / period))
    bench.progress('{} times {:.0f} s of driving'.format(loops, period))
    folder, watch = bench.watched_replay(
        os.path.join(field, 'field.bag'),
        'loops:={}'.format(loops),
        'loop_period:={:.9f}'.format(period),
        'loop_step_x:={:.9f}'.format(step),
    )
    times, memory = memory_over_time(watch.diagnostics())
    since = times - drive['time'][0] if times[0] < 1e9 else times - times[0]
    run = evaluation.Run(folder)
    early, late = settled_line(since, memory)
    grown = late - early
    share = 1.0 - SETTLED / since[-1]
    figures = {
        'minutes': since[-1] / 60.0,
        'km': loops * step / 1e3,
        'plants': len(run),
        'duplicates': len(ids_of_one_place(run, os.path.join(folder, 'journal.sqlite'))),
        'memory_early': early,
        'memory_late': late,
        'growth': grown / early,
        'bytes_per_plant': grown * 1e6 / (share * len(run)),
        'times': played_speed(watch.said, 'all is worked'),
    }
    print_row('one lane', columns, figures)
    return {'one lane': figures}


TABLES = {
    'passes': passes_table,
    'clouds': clouds_table,
    'load': load_table,
    'memory': memory_table,
}
