"""The completion benchmark over a few stems, checked at the figures that it is to reach."""

import os
import unittest

from program_support import ProgramTest

from field_phenotyping_tools import benchmarks, completion_benchmark


class BenchmarkCompletion(ProgramTest):
    def test_gaps(self):
        for seed in (3, 4):
            rows, _ = self.printed(completion_benchmark.gaps, seed, stems=3)
            self.assertEqual(len(rows), 7)
            for damage, row in rows.items():
                self.assertGreaterEqual(row['pc'], 0.95, damage)
                self.assertGreaterEqual(row['sm'], 0.965, damage)
                self.assertGreaterEqual(row['rd'], 0.91, damage)
                self.assertLessEqual(row['rmse'], 1.5e-3, damage)
                self.assertLess(row['before_pc'], 0.6, damage)
            self.assertGreaterEqual(rows['all']['sm'], 0.97)
            self.assertGreaterEqual(rows['all']['coverage'], 0.90)
            self.assertLessEqual(rows['all']['coverage'], 0.99)
        self.assertTrue(os.path.isfile(self.path('completion_gaps.png')))

    def test_rivals(self):
        rows, said = self.printed(completion_benchmark.rivals, stems=1, damages=('gap 10 cm',))
        methods = [name for name in ('MLS', 'kNN', 'VGC', 'NNI') if name in rows]
        self.assertGreaterEqual(len(methods), 3)  # NNI only where CGAL is
        self.assertEqual(rows['ours']['rank_rmse'], 1)
        self.assertLessEqual(rows['ours']['rank_sm'], 2)
        self.assertLessEqual(rows['ours']['rank_rd'], 2)
        for method in methods:
            self.assertGreater(rows[method]['filled'], 0.0, method)
            self.assertGreater(rows[method]['rmse'], rows['ours']['rmse'], method)
            self.assertIn(method + ',', said)

    def test_real_stems(self):
        if benchmarks.real_data() is None:
            self.skipTest('the real clouds are not there')
        clouds = ('label3dmaize_v-9-3', 'mospc_mid_1', 'mospc_small_1')
        rows, _ = self.printed(completion_benchmark.real, clouds=clouds, rivals=False)
        self.assertGreaterEqual(rows['gaps']['all']['coverage'], 0.85)
        for damage in ('gap 5 cm', 'gap 10 cm', 'gap 20 cm', '50 % thinned'):
            self.assertGreaterEqual(rows['gaps'][damage]['coverage'], 0.90, damage)
        self.assertNotIn('rmse', rows['gaps']['as seen'])  # nothing was cut out

    def test_odd_stems(self):
        rows, _ = self.printed(completion_benchmark.odd, stems=3)
        for name, row in rows.items():
            self.assertLessEqual(row['deepest'], 1e-4, name)
        for name in ('8 points', 'no points', '40 points'):
            self.assertEqual(rows[name]['empty'], 3, name)
            self.assertEqual(rows[name]['flagged'], 3, name)
        self.assertEqual(rows['fork of 15 deg']['flagged'], 3)
        self.assertLessEqual(rows['bent by 20 deg, gap 20 cm']['rmse'], 1.5e-3)

    def test_command_line(self):
        self.assert_benchmark_command_line('benchmark_completion', completion_benchmark.TABLES)
        refused = self.run_program('COMPLETE_STEMS', '--output', self.path('no', 'folder.json'),
                                   '--stems', '1', '--points', '50')  # fmt: skip
        self.assert_refused(refused, 'folder.json')


if __name__ == '__main__':
    unittest.main()
