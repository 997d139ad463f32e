"""Tests what benchmark_live reads from a journal."""

import os
import sqlite3
import tempfile
import unittest

import numpy as np
import support  # noqa: F401

from field_phenotyping_tools import live_benchmark


class SinglePasses(unittest.TestCase):
    def test_the_newest_revision_of_each_pass_counts(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'journal.sqlite')
            with sqlite3.connect(path) as database:
                database.execute('CREATE TABLE report (number INTEGER, began_ns INTEGER)')
                database.execute(
                    'CREATE TABLE plant (report INTEGER, plant_id INTEGER, height REAL, '
                    'height_stddev REAL, stem_diameter REAL, stem_diameter_stddev REAL)'
                )
                database.executemany('INSERT INTO report VALUES (?, ?)', [(1, 9), (2, 9), (3, 5)])
                database.executemany(
                    'INSERT INTO plant VALUES (?, 7, ?, 0.02, ?, ?)',
                    [(1, 1.0, 0.02, 1e-3), (2, 1.1, 0.021, 1e-3), (3, 1.2, None, None)],
                )
            passes = live_benchmark.single_passes(path)
        self.assertEqual(list(passes), [7])
        older, newer = passes[7]
        self.assertEqual(older['height'], (1.2, 0.02))
        self.assertNotEqual(older['stem_diameter'][0], older['stem_diameter'][0])
        self.assertEqual(newer['height'], (1.1, 0.02))
        self.assertEqual(newer['stem_diameter'], (0.021, 1e-3))


class Duplicates(unittest.TestCase):
    def test_only_plants_that_were_never_reported_together_count(self):
        class Run:
            ids = np.array([1, 2, 3, 4])
            bases = np.array([[0.0, 0, 0], [0.03, 0, 0], [5.0, 0, 0], [5.0, 0.04, 0]])

        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'journal.sqlite')
            with sqlite3.connect(path) as database:
                database.execute('CREATE TABLE plant (report INTEGER, plant_id INTEGER)')
                database.executemany(
                    'INSERT INTO plant VALUES (?, ?)', [(1, 1), (2, 1), (2, 2), (3, 3), (4, 4)]
                )
            self.assertEqual(live_benchmark.ids_of_one_place(Run, path), [(3, 4)])


class Sayings(unittest.TestCase):
    def test_speed_is_that_of_the_stage_that_is_asked_for(self):
        said = (
            '[player] 5.0 of 9.0 s, 50 scans, in 2.0 s, 2.5 x real time, about 2 s left\n'
            '[player] 9.0 of 9.0 s, 90 scans, in 3.0 s, 3.0 x real time: all scans are placed\n'
            '[player] 9.0 of 9.0 s, 90 scans, in 6.0 s, 1.5 x real time: all is worked\n'
        )
        self.assertEqual(live_benchmark.played_speed(said, 'all scans are placed'), 3.0)
        self.assertEqual(live_benchmark.played_speed(said, 'all is worked'), 1.5)
        never = live_benchmark.played_speed('', 'all is worked')
        self.assertNotEqual(never, never)

    def test_memory_comes_from_the_diagnostics_that_tell_it(self):
        name = 'memory of the process [MB]'
        times, memory = live_benchmark.memory_over_time(
            {'preprocessing': [(1.0, {}), (2.0, {name: 70.0}), (3.0, {name: 71.0, 'rate': 1.0})]}
        )
        self.assertEqual(list(times), [2.0, 3.0])
        self.assertEqual(list(memory), [70.0, 71.0])

    def test_growth_is_that_of_the_line_while_the_drive_lasts(self):
        since = np.arange(0.0, 7201.0, 60.0)
        memory = 60.0 + 0.001 * since + np.where(np.arange(len(since)) % 2 == 0, 3.0, -3.0)
        memory[since < live_benchmark.SETTLED] = 10.0  # it has only begun
        since, memory = np.append(since, [7200.0] * 9), np.append(memory, [200.0] * 9)  # all waits
        early, late = live_benchmark.settled_line(since, memory)
        self.assertAlmostEqual(early, 60.0 + 0.3, delta=0.3)
        self.assertAlmostEqual(late, 60.0 + 7.2, delta=0.3)


if __name__ == '__main__':
    unittest.main()
