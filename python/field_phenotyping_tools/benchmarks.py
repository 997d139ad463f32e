"""What the benchmark programs share: fields, runs of the programs, and tables of their figures."""

import argparse
import collections
import contextlib
import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time

from . import evaluation
from .errors import InputError

STAGES = ('jointing', 'tasselling', 'ripe')
_OF_80_PLANTS = ['--plants-per-row', '20', '--points', '600000']  # as dense as a whole field
# (label, settings of simulate_field) of fields that are harder than the plain one
HARD_FIELDS = (
    ('seedlings', ['--stage', 'seedling'] + _OF_80_PLANTS),
    ('noise 10 mm', ['--noise', '0.010'] + _OF_80_PLANTS),
    ('35 % dropouts', ['--dropout', '0.35'] + _OF_80_PLANTS),
    ('150,000 points on 80 plants', ['--plants-per-row', '20', '--points', '150000']),
    ('10 deg slope, 6 cm ridges', ['--slope', '10', '--ridge-height', '0.06'] + _OF_80_PLANTS),
    ('250 weeds on 12 m^2', ['--weeds', '250'] + _OF_80_PLANTS),
    ('lodged, sd 14 deg', ['--lean-stddev', '14'] + _OF_80_PLANTS),
    (
        '0.45 x 0.10 m, 1.8 m tall, 340,000 points on 80 plants',
        ['--row-spacing', '0.45', '--plant-spacing', '0.1', '--plant-height', '1.8']
        + ['--plants-per-row', '20', '--points', '340000'],
    ),
)


class Bench:
    """Runs the programs in a folder of its own, which is gone when the `with` block ends.

    The programs are found with rosrun, or where an environment variable with their name in capitals
    says. What is done goes to standard error with the seconds since the start.
    """

    def __init__(self, seed=1, quick=False):
        self.seed = seed
        self.quick = quick  # small fields and few runs, for a look
        self._begin = time.time()
        self._count = 0
        self._known_fields = {}

    def __enter__(self):
        self._folder = tempfile.mkdtemp(prefix='field_phenotyping_benchmark_')
        return self

    def __exit__(self, *_):
        shutil.rmtree(self._folder, ignore_errors=True)

    def progress(self, text):
        print('{:5.0f} s  {}'.format(time.time() - self._begin, text), file=sys.stderr, flush=True)

    def new_folder(self, name):
        """A path that nothing is at yet."""
        self._count += 1
        return os.path.join(self._folder, '{}_{}'.format(name, self._count))

    def run(self, name, *arguments):
        """Runs a program of this package; raises InputError with what it said if it fails."""
        program = os.environ.get(name.upper())
        command = [program] if program else ['rosrun', 'field_phenotyping', name]
        self._run(command + [str(argument) for argument in arguments])

    def json_rows(self, name, *arguments):
        """What a program of this package writes to the JSON file that its --output names."""
        path = self.new_folder('rows') + '.json'
        self.run(name, *arguments, '--output', path)
        with open(path) as file:
            return json.load(file)

    def count_instructions(self, cloud, *settings):
        """{function: instructions, with what it calls} of a run of phenotype_cloud on one thread.

        By callgrind; functions are named without their parameters.
        """
        program = os.environ.get('PHENOTYPE_CLOUD') or self._output(
            'catkin_find', '--first-only', '--libexec', 'field_phenotyping', 'phenotype_cloud'
        )
        counts = self.new_folder('callgrind')
        self._run(
            ['valgrind', '--tool=callgrind', '--callgrind-out-file=' + counts, program.strip()]
            + [cloud, '--output', self.new_folder('run'), '--threads', '1', '--device', 'cpu']
            + list(settings)
        )
        table = self._output(
            'callgrind_annotate', '--inclusive=yes', '--threshold=100', '--auto=no', counts
        )
        functions = re.findall(r'^\s*([\d,]+) .*?:(field_phenotyping::[\w:]+)\(', table, re.MULTILINE)
        instructions = {}
        for count, name in functions:  # most first: lambdas inside a function come after it
            instructions.setdefault(name, int(count.replace(',', '')))
        return instructions

    def _output(self, *command):
        return self._run(list(command), stdout=subprocess.PIPE).stdout

    def _run(self, command, stdout=subprocess.DEVNULL):
        try:
            done = subprocess.run(
                command,
                stdout=stdout,
                stderr=subprocess.PIPE,
                universal_newlines=True,
            )
        except OSError as error:
            raise InputError(
                'Cannot run {}: {}. Start this through scripts/env.'.format(
                    command[0], error.strerror
                )
            )
        if done.returncode != 0:
            raise InputError('{} failed:\n{}'.format(' '.join(command), done.stderr.strip()))
        return done

    def simulate(self, *settings):
        """Folder of a new simulated field, of the bench's seed if the settings give none."""
        field = self.new_folder('field')
        seed = [] if '--seed' in settings else ['--seed', self.seed]
        self.run('simulate_field', '--no-bag', '--output', field, *seed, *settings)
        return field

    def known_field(self, *settings):
        """The same, simulated when these settings are first asked for."""
        if settings not in self._known_fields:
            self._known_fields[settings] = self.simulate(*settings)
        return self._known_fields[settings]

    def drive(self, *settings):
        """Folder of a new simulated field with the bag of the drive through it."""
        field = self.new_folder('field')
        self.run('simulate_field', '--output', field, '--seed', self.seed, *settings)
        return field

    def replay(self, bag, *settings):
        """Folder of what replay.launch makes of a bag, with a ROS master of its own, and seconds."""
        output, environment = self._new_replay()
        begin = time.time()
        self._replay(bag, settings, output, environment)
        return output, time.time() - begin

    def watched_replay(self, bag, *settings):
        """Like replay(), and what was to be seen meanwhile: (folder, Watch)."""
        output, environment = self._new_replay()
        with Watch(environment, os.path.join(output, 'diagnostics.bag')) as watch:
            watch.said = self._replay(bag, settings, output, environment)
        return output, watch

    def _new_replay(self):
        """A folder for its output, and the environment of its nodes."""
        output = self.new_folder('replay')
        os.makedirs(output)
        with socket.socket() as listener:
            listener.bind(('127.0.0.1', 0))
            port = listener.getsockname()[1]
        environment = dict(
            os.environ,
            ROS_MASTER_URI='http://localhost:{}'.format(port),
            ROS_HOME=os.path.join(output, 'ros'),
        )
        return output, environment

    def _replay(self, bag, settings, output, environment):
        """Waits for its end; returns what the nodes said."""
        command = ['roslaunch', '-p', _port_of(environment), 'field_phenotyping', 'replay.launch']
        command += ['bag:=' + bag, 'output:=' + output] + [str(setting) for setting in settings]
        said = os.path.join(output, 'log')
        with open(said, 'w') as log:
            done = subprocess.run(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        words = _words_in(said)
        if done.returncode != 0:
            raise InputError('{} failed:\n{}'.format(' '.join(command), words[-4000:]))
        return words

    def measure(self, cloud, *settings):
        """Folder of a run of phenotype_cloud with its defaults and `settings`."""
        run = self.new_folder('run')
        self.run('phenotype_cloud', cloud, '--output', run, *settings)
        return run

    def cluster(self, cloud, method, *settings):
        """Folder of a run of pcl_clusters."""
        run = self.new_folder(method)
        self.run('pcl_clusters', cloud, '--method', method, '--output', run, *settings)
        return run

    def simulated_figures(self, *settings):
        """What `evaluate` finds for phenotype_cloud on a simulated field."""
        field = self.simulate(*settings)
        return score(self.measure(cloud_of(field)), field)


def _port_of(environment):
    return environment['ROS_MASTER_URI'].rsplit(':', 1)[1]


def _words_in(path):
    with open(path, errors='replace') as file:
        return file.read()


def _mind_interrupts():
    """What a shell starts in the background ignores them, and these programs then do not end."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Watch:
    """Starts a ROS master and records its diagnostics while the `with` block lasts.

    The recorder has begun before the block does, and the bag is whole when it ends; else there is
    an InputError.
    """

    def __init__(self, environment, diagnostics, patience=60.0):
        self.said = ''  # by the nodes
        self._environment = environment
        self._diagnostics = diagnostics
        self._patience = patience  # [s] with each step, on a busy machine
        self._processes = []

    def __enter__(self):
        try:
            self._start('roscore', '-p', _port_of(self._environment))
            # rosrun becomes the recorder; `rosbag record` may end before it, which then still writes.
            self._start(
                *('rosrun', 'rosbag', 'record', '-O', self._diagnostics, '/diagnostics'),
                '__name:=diagnostics_recorder',
            )
            self._wait_for_begin()
        except BaseException:
            self._kill()
            raise
        return self

    def __exit__(self, kind, *_):
        core, recorder = self._processes
        try:
            self._end(recorder)
            self._end(core)
        finally:
            self._kill()
        if kind is None and not os.path.exists(self._diagnostics):
            self._fail(recorder, 'left no bag')

    def _start(self, *command):
        with open(self._diagnostics + '.log', 'a') as log:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=_mind_interrupts,
            )
        self._processes.append(process)

    def _wait_for_begin(self):
        recorder = self._processes[-1]
        end = time.time() + self._patience
        while not os.path.exists(self._diagnostics + '.active'):
            if recorder.poll() is not None:
                self._fail(recorder, 'ended with {}'.format(recorder.returncode))
            if time.time() > end:
                self._fail(recorder, 'has not begun within {:.0f} s'.format(self._patience))
            time.sleep(0.05)

    def _end(self, process):
        process.send_signal(signal.SIGINT)
        try:
            process.wait(self._patience)
        except subprocess.TimeoutExpired:
            self._fail(process, 'has not ended within {:.0f} s'.format(self._patience))

    def _kill(self):
        for process in self._processes:
            process.kill()
            process.wait()

    def _fail(self, process, what):
        words = _words_in(self._diagnostics + '.log')
        raise InputError('{} {}:\n{}'.format(' '.join(process.args), what, words[-4000:]))

    def diagnostics(self):
        """{stage: [(ROS time [s], {name: number})]}, oldest first."""
        import rosbag

        stages = {}
        with rosbag.Bag(self._diagnostics) as bag:
            for _, message, _ in bag.read_messages():
                for status in message.status:
                    stage = status.name.split(':')[0].strip().rsplit('/', 1)[-1]
                    values = {}
                    for entry in status.values:
                        try:
                            values[entry.key] = float(entry.value)
                        except ValueError:
                            pass
                    stages.setdefault(stage, []).append((message.header.stamp.to_sec(), values))
        return stages


def cloud_of(field):
    return os.path.join(field, 'cloud.pcd')


def score(run, truth):
    """The figures that `evaluate --json` writes, in metres and radians."""
    return evaluation.evaluate(evaluation.Run(run), truth).figures


def stage_times(run):
    """Seconds of each stage of a run of phenotype_cloud, and their sum as `whole`."""
    with open(os.path.join(run, 'timing.json')) as file:
        times = {stage: time['seconds'] for stage, time in json.load(file).items()}
    return dict(times, whole=sum(times.values()))


def figure(name, scale=1.0, decimals=2):
    """Text of a figure; metres become the unit that `scale` makes of them."""

    def text(figures):
        value = figures.get(name)
        if value is None or value != value:
            return '-'
        return '{:.{}f}'.format(scale * value, decimals)

    return text


def recall_and_precision(figures):
    return ' / '.join(figure(name, decimals=3)(figures) for name in ('recall', 'precision'))


def print_header(first, columns):
    """Starts a Markdown table. columns: (title, text of a row's figures) of each but the first."""
    print('\n| {} |'.format(' | '.join([first] + [title for title, _ in columns])))
    print('|---' * (1 + len(columns)) + '|', flush=True)


def print_row(label, columns, figures):
    print('| {} |'.format(' | '.join([label] + [text(figures) for _, text in columns])), flush=True)


def note_load():
    """Says so where more was running than there are cores, for then seconds mean little."""
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    if load > cores + 0.5:
        print(
            '\nBUSY: load {:.1f} on {} cores; do not trust the seconds above.'.format(load, cores),
            flush=True,
        )


def real_data():
    """Folder of the real clouds; None, with a word about it, where it is not there."""
    data = os.environ.get('FIELD_PHENOTYPING_DATA') or _default_data()
    if os.path.isdir(data):
        return data
    print(
        '\nSKIPPED real: the real clouds are not at {}. Set FIELD_PHENOTYPING_DATA to their '
        'folder.'.format(os.path.abspath(data)),
        flush=True,
    )
    return None


def _default_data():
    """Beside the checkout, where the tests look too."""
    package = os.path.dirname(os.path.realpath(__file__))
    return os.path.join(package, '..', '..', '..', 'shared', 'data')


class Report(collections.namedtuple('Report', 'preface closing')):
    """What a benchmark prints round its tables, so that all of it can be kept as a document.

    preface(bench) comes before the tables, closing(figures of all tables) after them.
    """


class _Tee:
    """A stream that also keeps what is written to it."""

    def __init__(self, stream):
        self.kept = io.StringIO()
        self._stream = stream

    def write(self, text):
        self.kept.write(text)
        return self._stream.write(text)

    def flush(self):
        self._stream.flush()


def main(program, description, tables, pictures, figures, duration, report=None):
    """Command line of a benchmark program: prints some of its tables, or all. Returns its status.

    tables: {name: function of a Bench and the folder for pictures that returns figures}
    pictures, figures: names of the files that are written; None for no picture
    duration: in words, of all tables
    report: a Report; the program then has --quick and --report
    """
    parser = argparse.ArgumentParser(
        prog=program,
        description=description,
        epilog='exit status: 0 done, 2 a program failed or the output cannot be written',
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        'tables',
        nargs='*',
        metavar='TABLE',
        help='{}; all by default, {}'.format(', '.join(tables), duration),
    )
    parser.add_argument('--seed', type=int, default=1, help='of what is simulated (default 1)')
    parser.add_argument(
        '--output',
        metavar='DIR',
        default=os.path.join('build', 'benchmark'),
        help='folder for {} [m, rad, s] (default build/benchmark)'.format(
            ' and '.join(filter(None, (pictures, figures)))
        ),
    )
    if report:
        parser.add_argument(
            '--quick', action='store_true', help='small fields and one run of each, for a look'
        )
        parser.add_argument(
            '--report',
            metavar='FILE',
            help='also keep what is printed as this Markdown file, with the pictures beside it',
        )
    options = parser.parse_args()
    for name in options.tables:
        if name not in tables:
            parser.error('no table {}; there are {}'.format(name, ', '.join(tables)))
    try:
        if report:
            _run_report(options, tables, figures, report)
        else:
            _run(options, tables, figures)
    except InputError as error:
        print('{}: error: {}'.format(program, error), file=sys.stderr)
        return 2
    except OSError as error:
        print(
            '{}: error: {}: {}. Is the folder writable, the disk full?'.format(
                program, error.filename, error.strerror
            ),
            file=sys.stderr,
        )
        return 2
    return 0


def _run(options, tables, figures_name):
    os.makedirs(options.output, exist_ok=True)
    with Bench(options.seed) as bench:
        figures = _run_tables(bench, options, tables, options.output)
    _write_figures(options, figures_name, figures)


def _run_report(options, tables, figures_name, report):
    os.makedirs(options.output, exist_ok=True)
    folder = os.path.dirname(options.report) or '.' if options.report else options.output
    os.makedirs(folder, exist_ok=True)
    with Bench(options.seed, options.quick) as bench:
        said = _Tee(sys.stdout)
        with contextlib.redirect_stdout(said):
            report.preface(bench)
            figures = _run_tables(bench, options, tables, folder)
            report.closing(figures)
    if options.report:
        with open(options.report, 'w') as file:
            file.write(said.kept.getvalue().strip() + '\n')
    _write_figures(options, figures_name, figures)


def _run_tables(bench, options, tables, folder):
    figures = {name: tables[name](bench, folder) for name in options.tables or tables}
    bench.progress('done')
    return figures


def _write_figures(options, name, figures):
    path = os.path.join(options.output, name)
    with open(path, 'w') as file:
        json.dump(figures, file, indent=1)
    print('\nWrote {}'.format(path))
