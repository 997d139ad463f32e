"""Runs the compiled programs and makes small clouds whose plants are known exactly.

The programs are found through PHENOTYPE_CLOUD and SIMULATE_FIELD, which ctest sets.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import unittest

import numpy as np

ROOT = os.path.abspath(os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', '..'))
sys.path.insert(0, os.path.join(ROOT, 'test', 'python'))
sys.path.insert(0, os.path.join(ROOT, 'python'))

from support import FolderTest, write_pcd  # noqa: E402, F401
from field_phenotyping_tools import benchmarks  # noqa: E402
from field_phenotyping_tools.pcd import read_pcd  # noqa: E402

XYZ = np.dtype([('x', 'f4'), ('y', 'f4'), ('z', 'f4')])
PLANTS = np.array([[0.6, 0.5], [1.5, 0.6], [2.0, 1.4]])  # the last stands on the border of a tile
PLANT_HEIGHT = 1.2  # [m]
STEM_DIAMETER = 0.022  # [m]
_PROGRESS = re.compile(r'^[\w ]+: \d+ %$')


class ProgramTest(FolderTest):
    """Runs a program and looks at its exit status and at what it says."""

    def run_program(self, variable, *arguments):
        """(exit status, standard output, lines of standard error that are no progress)."""
        program = os.environ.get(variable)
        if not program:
            raise unittest.SkipTest('SKIPPED: {} does not name the program'.format(variable))
        done = subprocess.run(
            [program] + [str(argument) for argument in arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
            cwd=self.folder,
        )
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        self.progress = [line for line in lines if _PROGRESS.match(line)]
        return done.returncode, done.stdout, [l for l in lines if l not in self.progress]

    def measure(self, *arguments):
        return self.run_program('PHENOTYPE_CLOUD', *arguments)

    def simulate(self, *arguments):
        return self.run_program('SIMULATE_FIELD', *arguments)

    def evaluate(self, *arguments):
        """Exit status and output of tools/evaluate."""
        done = subprocess.run(
            [sys.executable, os.path.join(ROOT, 'tools', 'evaluate')] + list(arguments),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            universal_newlines=True,
        )
        return done.returncode, done.stdout

    def printed(self, table, seed=3, **settings):
        """Figures and standard output of a table of a benchmark program."""
        out = io.StringIO()
        with benchmarks.Bench(seed) as bench, contextlib.redirect_stdout(out):
            rows = table(bench, self.folder, **settings)
        print(out.getvalue())
        return rows, out.getvalue()

    def assert_benchmark_command_line(self, name, tables):
        """A benchmark program explains its tables, refuses others, and skips what has no data."""

        def run(*arguments):
            return subprocess.run(
                [sys.executable, os.path.join(ROOT, 'benchmark', name)] + list(arguments),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                universal_newlines=True,
                cwd=self.folder,
                env=dict(os.environ, FIELD_PHENOTYPING_DATA=self.path('nowhere')),
            )

        said = run('--help').stdout
        for table in tables:
            self.assertIn(table, said)
        self.assertIn('no table nothing', run('nothing').stderr)
        if 'real' in tables:
            self.assertIn('SKIPPED real', run('real').stdout)

    def assert_refused(self, result, *fragments):
        """One clear complaint that holds all fragments, and a failing exit status: no crash."""
        status, _, lines = result
        said = '\n'.join(lines)
        self.assertGreater(status, 0, 'killed by a signal or no failure; said: ' + said)
        self.assertLess(status, 128, said)
        self.assertIn(len(lines), (1, 2), 'not one clear line:\n' + said)
        for fragment in fragments:
            self.assertIn(fragment, said)

    def assert_done(self, result):
        status, out, lines = result
        self.assertEqual(status, 0, '\n'.join(lines))
        return out


def small_field(seed=1):
    """Three plants with leaves on gently sloping soil; (n, 3) positions [m]."""
    random = np.random.RandomState(seed)
    soil = np.column_stack([random.uniform(0.0, 3.0, 9000), random.uniform(0.0, 2.0, 9000)])
    parts = [_on_soil(soil, random.normal(0.0, 0.003, len(soil)))]
    for base in PLANTS:
        angle = random.uniform(0.0, 2.0 * np.pi, 2500)
        radius = 0.5 * STEM_DIAMETER + random.normal(0.0, 0.001, angle.size)
        flat = base + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        foot = _on_soil(base[None], 0.0)[0, 2]
        parts.append(
            np.column_stack([flat, foot + random.uniform(0.0, PLANT_HEIGHT, angle.size)])
        )
        for leaf in range(4):
            along = random.uniform(0.0, 0.35, 500)
            across = random.uniform(-0.02, 0.02, along.size)
            azimuth = np.pi * leaf + 0.3
            out = np.array([np.cos(azimuth), np.sin(azimuth)])
            flat = base + (0.011 + along)[:, None] * out
            flat = flat + across[:, None] * np.array([-out[1], out[0]])
            rise = 0.35 + 0.15 * leaf + 0.8 * along - 1.6 * along**2
            parts.append(np.column_stack([flat, foot + rise]))
    return np.concatenate(parts)


def _on_soil(flat, above):
    return np.column_stack([flat, 0.05 * flat[:, 0] + above])


def as_cloud(positions, kind='f4', **fields):
    """A structured array with x, y, z of the given type and more fields."""
    names = [(axis, kind) for axis in 'xyz']
    names += [(name, values.dtype) for name, values in fields.items()]
    cloud = np.zeros(len(positions), np.dtype(names))
    for k, axis in enumerate('xyz'):
        cloud[axis] = positions[:, k]
    for name, values in fields.items():
        cloud[name] = values
    return cloud


def read_table(path):
    """Rows of a CSV as dictionaries of text, and the header."""
    with open(path) as file:
        lines = file.read().splitlines()
    header = lines[0].split(',')
    return [dict(zip(header, line.split(','))) for line in lines[1:]], header


def labels_of(folder):
    return read_pcd(os.path.join(folder, 'labels.pcd'))


def content(path):
    with open(path, 'rb') as file:
        return file.read()
