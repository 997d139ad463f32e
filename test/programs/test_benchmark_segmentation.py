"""The segmentation benchmark over a field of three plants; its figures are not looked at here."""

import contextlib
import io
import json
import os
import subprocess
import sys
import unittest

from program_support import ROOT, ProgramTest, labels_of, read_table

from field_phenotyping_tools import benchmarks, segmentation_benchmark

FIELD = ['--rows', '1', '--plants-per-row', '3', '--points', '20000']
GRID = ['--normal-neighbours', '20', '--neighbours', '15', '--smoothness', '20']
GRID += ['--curvature', '0.1', '--tolerance', '0.01']


class BenchmarkSegmentation(ProgramTest):
    def benchmark(self, *arguments, **environment):
        """Exit status, standard output and standard error."""
        done = subprocess.run(
            [sys.executable, os.path.join(ROOT, 'benchmark', 'benchmark_segmentation')]
            + list(arguments),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
            cwd=self.folder,
            env=dict(os.environ, **environment),
        )
        return done.returncode, done.stdout, done.stderr

    def printed(self, table, **settings):
        """Figures and standard output of a table over real runs of the programs."""
        out = io.StringIO()
        with benchmarks.Bench(seed=3) as bench, contextlib.redirect_stdout(out):
            rows = table(bench, self.folder, **settings)
        print(out.getvalue())
        return rows, out.getvalue()

    def test_rivals(self):
        rows, said = self.printed(
            segmentation_benchmark.rivals, stages=('ripe',), field=FIELD, grid=GRID
        )
        self.assertEqual(len(rows), 3)
        for label, figures in rows.items():
            self.assertGreater(figures['segmentation_s'], 0.0, label)
            self.assertGreaterEqual(figures['whole_s'], figures['segmentation_s'], label)
            self.assertEqual(figures['truth_plants'], 3)
            self.assertGreaterEqual(figures['sa'], 0.5, label)
        self.assertIn('normal_neighbours 20, neighbours 15', said)

    def test_sweep(self):
        rows, _ = self.printed(segmentation_benchmark.m_sweep, field=FIELD, values=(0.5,))
        self.assertIn('stem_f1', rows[0.5])
        self.assertTrue(os.path.isfile(self.path('m_sweep.png')))

    def test_scaling(self):
        rows, _ = self.printed(segmentation_benchmark.scaling, plants={1: (1, 1), 8: (1, 8)})
        self.assertGreater(rows['8 x']['time_ratio'], 0.0)

    def test_pcl_clusters_keeps_the_best_of_its_grid(self):
        field = self.path('field')
        self.assert_done(self.simulate('--no-bag', '--output', field, *FIELD))
        cloud = self.path('field', 'cloud.pcd')
        chosen = {}
        for tolerances in (['0.01'], ['0.5'], ['0.5', '0.01']):
            self.assert_done(
                self.run_program(
                    'PCL_CLUSTERS', cloud, '--method', 'euclidean', '--output', self.path('run'),
                    '--tolerance', *tolerances,
                )
            )  # fmt: skip
            with open(self.path('run', 'result.json')) as file:
                result = json.load(file)
            figures = benchmarks.score(self.path('run'), field)
            self.assertAlmostEqual(result['stem_f1'], figures['stem_f1'], places=6)
            plants, _ = read_table(self.path('run', 'plants.csv'))
            self.assertEqual(len(plants), result['plants'])
            self.assertEqual(len(labels_of(self.path('run'))), 20000)
            chosen[len(tolerances), tolerances[0]] = result
        best = max(chosen[1, '0.01']['stem_f1'], chosen[1, '0.5']['stem_f1'])
        self.assertEqual(chosen[2, '0.5']['stem_f1'], best)
        self.assertNotEqual(chosen[1, '0.01']['stem_f1'], chosen[1, '0.5']['stem_f1'])

    def test_pcl_clusters_needs_the_truth(self):
        cloud = self.path('bare.pcd')
        with open(cloud, 'w') as file:
            file.write(
                'VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\n'
                'HEIGHT 1\nPOINTS 1\nDATA ascii\n0 0 0\n'
            )
        result = self.run_program('PCL_CLUSTERS', cloud, '--method', 'euclidean', '-o', 'run')
        self.assert_refused(result, 'part')

    def test_command_line(self):
        status, said, _ = self.benchmark('--help')
        self.assertEqual(status, 0)
        for name in segmentation_benchmark.TABLES:
            self.assertIn(name, said)
        status, _, complaint = self.benchmark('nothing')
        self.assertEqual(status, 2)
        self.assertIn('no table nothing', complaint)
        status, said, progress = self.benchmark(
            'real', '--output', 'results', FIELD_PHENOTYPING_DATA=self.path('nowhere')
        )
        self.assertEqual(status, 0, progress)
        self.assertIn('SKIPPED real', said)
        self.assertRegex(progress, r'\d s  done')
        self.assertTrue(os.path.isfile(self.path('results', 'figures.json')))
        status, _, complaint = self.benchmark('fields', SIMULATE_FIELD='/bin/false')
        self.assertEqual(status, 2)
        self.assertIn('/bin/false', complaint)


if __name__ == '__main__':
    unittest.main()
