"""simulate_field from the outside; what it simulates is tested in test/simulation."""

import csv
import json
import os
import unittest

import numpy as np

from program_support import ProgramTest, content, read_pcd

SMALL = ('--rows', '1', '--plants-per-row', '3', '--points', '8000', '--no-bag')


class SimulateField(ProgramTest):
    def test_help_names_units(self):
        said = self.assert_done(self.simulate('--help'))
        for option in ('--stage', '--row-spacing', '--noise', '--beams', '--seed', '--output'):
            self.assertIn(option, said)
        for unit in ('[m]', '[deg]', '[m/s]', '[mrad]', '[Hz]', '[count]'):
            self.assertIn(unit, said)

    def test_files(self):
        out = self.path('new', 'field')
        self.assert_done(self.simulate('--output', out, '--seed', '5', *SMALL))
        cloud = read_pcd(os.path.join(out, 'cloud.pcd'))
        self.assertTrue({'x', 'y', 'z', 'plant_id', 'part'} <= set(cloud.dtype.names))
        self.assertAlmostEqual(len(cloud), 8000, delta=400)
        with open(os.path.join(out, 'truth.csv')) as file:
            truth = list(csv.DictReader(file))
        self.assertEqual(len(truth), 3)
        for column in ('plant_id', 'x', 'y', 'z', 'height', 'stem_diameter',
                       'stem_diameter_minor', 'diameter_height'):  # fmt: skip
            for row in truth:
                self.assertTrue(np.isfinite(float(row[column])), column)
        ids = {int(row['plant_id']) for row in truth}
        self.assertTrue(set(cloud['plant_id'][cloud['plant_id'] >= 0]) <= ids)
        with open(os.path.join(out, 'simulation.json')) as file:
            json.load(file)

    def test_same_seed_same_bytes(self):
        for name, seed, threads in (('a', '7', '1'), ('b', '7', '2'), ('c', '8', '2')):
            self.assert_done(
                self.simulate(
                    '--output', self.path(name), '--seed', seed, '--threads', threads, *SMALL
                )
            )
        for name in ('cloud.pcd', 'truth.csv', 'trajectory.csv'):
            self.assertEqual(content(self.path('a', name)), content(self.path('b', name)), name)
        for name in ('cloud.pcd', 'truth.csv'):
            self.assertNotEqual(content(self.path('a', name)), content(self.path('c', name)), name)

    def test_bad_settings_are_refused(self):
        for setting, named in (
            ({'--stage': 'autumn'}, '--stage'),
            ({'--rows': '-1'}, 'row'),
            ({'--rows': '0'}, 'row'),
            ({'--plants-per-row': '-3'}, 'plants per row'),
            ({'--plant-spacing': '0'}, 'plant spacing'),
            ({'--row-spacing': '-0.7'}, 'row spacing'),
            ({'--missing': '1.5'}, 'missing'),
            ({'--points': 'many'}, '--points'),
            ({'--points': '0', '--speed': '0'}, 'speed'),
            ({'--beams': '0'}, 'beam'),
            ({'--point-rate': '0'}, 'point rate'),
            ({'--scan-rate': '-1'}, 'scan rate'),
            ({'--noise': '-0.003'}, 'noise'),
            ({'--noise': 'nan'}, 'noise'),
            ({'--dropout': '2'}, 'dropout'),
            ({'--min-range': '50', '--max-range': '10'}, 'range'),
            ({'--slope': '95'}, 'slope'),
            ({'--unknown': '1'}, '--unknown'),
        ):
            with self.subTest(setting):
                values = {'--rows': '1', '--plants-per-row': '2', '--points': '2000'}
                values.update(setting)
                arguments = [word for pair in values.items() for word in pair]
                out = self.path('out')
                self.assert_refused(
                    self.simulate('--output', out, '--no-bag', *arguments), named
                )
                self.assertFalse(os.path.exists(os.path.join(out, 'cloud.pcd')))

    def test_bad_output(self):
        self.assert_refused(self.simulate(*SMALL), '--output')
        blocked = self.path('file')
        with open(blocked, 'w') as file:
            file.write('in the way')
        self.assert_refused(
            self.simulate('--output', os.path.join(blocked, 'out'), *SMALL), blocked
        )
        os.makedirs(self.path('out', 'cloud.pcd', 'in the way'))
        self.assert_refused(self.simulate('--output', self.path('out'), *SMALL), 'cloud.pcd')


if __name__ == '__main__':
    unittest.main()
