"""The measurement benchmark over few stems and a small field, checked at what it is to show."""

import os
import unittest

from program_support import ProgramTest

from field_phenotyping_tools import measurement_benchmark

SMALL_FIELD = ('--rows', '2', '--plants-per-row', '8', '--points', '120000')


class BenchmarkMeasurement(ProgramTest):
    def test_monte_carlo(self):
        sweeps = {'diameter': ('--diameter', 'mm', 1e-3, (12, 30))}
        rows, said = self.printed(
            measurement_benchmark.monte_carlo, trials=40, sweeps=sweeps, noises=(2,)
        )
        self.assertEqual(len(rows), 6 + 4 + 2)
        whole = rows['40 cm, 800 points, arc 360 deg, noise 2 mm']
        self.assertLess(abs(whole['bias']), 0.2e-3)
        self.assertLess(whole['of_bound'], 1.6)
        self.assertGreater(whole['of_bound'], 0.6)  # no estimate beats the bound by much
        self.assertGreater(whole['circle_bias'], 1e-3)
        # The bound itself: less is known of half a stem, and of fewer points.
        half = rows['40 cm, 800 points, arc 180 deg, noise 2 mm']
        few = rows['5 cm, 100 points, arc 360 deg, noise 2 mm']
        self.assertGreater(half['bound'], 1.3 * whole['bound'])
        self.assertGreater(few['bound'], 1.5 * whole['bound'])
        self.assertGreater(rows['noise 10 mm, arc 360 deg']['circle_bias'], 8e-3)
        self.assertIn('0.92 - 0.98', said)
        self.assertTrue(os.path.isfile(self.path('measurement_monte_carlo.png')))

    def test_fields(self):
        rows, said = self.printed(
            measurement_benchmark.fields,
            stages=('ripe',),
            noises=(0.003,),
            seeds=2,
            field=SMALL_FIELD,
        )
        self.assertEqual(len(rows), 3)
        row = rows['ripe, noise 3 mm']
        self.assertEqual(row['plants'], 32)
        self.assertGreaterEqual(row['recall'], 0.95)
        self.assertGreaterEqual(row['given'], 0.95)
        self.assertLess(row['rmse'], 1.2e-3)
        self.assertLess(row['perfect_rmse'], 1.2e-3)
        self.assertLess(row['height_rmse'], 2e-2)
        self.assertGreater(row['highest_rmse'], 1e-3)
        self.assertIn('| goal, noise 3 mm |', said)
        self.assertTrue(os.path.isfile(self.path('measurement_fields.png')))

    def test_rivals(self):
        rows, said = self.printed(
            measurement_benchmark.rivals, stages=('ripe',), seeds=1, field=SMALL_FIELD
        )
        ours = rows['ripe, this method']
        for method in ('paper mode, Eq 27', 'circle', 'voxel', 'projection'):
            row = rows['ripe, ' + method]
            self.assertLess(ours['diameter']['rmse'], row['diameter']['rmse'], method)
            self.assertEqual('height' in row, method != 'circle')
        self.assertIn('pixels of', said)
        self.assertIn('0.4835'[:4], said)

    def test_real(self):
        rows, said = self.printed(measurement_benchmark.trunks)
        if not rows:
            self.assertIn('SKIPPED', said)
            return
        self.assertLess(rows['this method']['rmse'], 1.0e-2)
        self.assertLess(abs(rows['this method']['bias']), 0.4e-2)
        self.assertLess(rows['this method']['rmse'], rows['circle']['rmse'])

    def test_real_stems(self):
        rows, said = self.printed(measurement_benchmark.real, clouds=('maizefield3d_T8',))
        if not rows:
            self.assertIn('SKIPPED', said)
            return
        self.assertGreater(rows['all']['n'], 20)
        self.assertGreaterEqual(rows['all']['coverage'], 0.75)
        self.assertLess(rows['all']['equivalent_rmse'], 10e-3)
        self.assertGreater(rows['all']['points'], 100)

    def test_command_line(self):
        self.assert_benchmark_command_line('benchmark_measurement', measurement_benchmark.TABLES)
        refused = self.run_program('MEASURE_STEMS', 'pieces', '--output',
                                   self.path('no', 'folder.json'), '--trials', '1')  # fmt: skip
        self.assert_refused(refused, 'folder.json')
        refused = self.run_program('MEASURE_STEMS', 'field', self.path('none'), '--output',
                                   self.path('rows.json'))  # fmt: skip
        self.assert_refused(refused, 'cloud.pcd')


if __name__ == '__main__':
    unittest.main()
