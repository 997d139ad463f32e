"""Tests what benchmark_live reads from a journal."""

import os
import sqlite3
import tempfile
import unittest

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


if __name__ == '__main__':
    unittest.main()
