"""Scored runs over small simulated fields, at the point density of the full-sized ones."""

import unittest

from program_support import ProgramTest, read_table

# A full-sized field of 120 plants must reach recall and precision 0.95, stem F1 and plant accuracy
# 0.80, heights within 0.04 m (median) and diameters within 0.003 m (RMSE). With 24 plants the first
# four scatter by some 0.05 from seed to seed.
CHECKS = (
    'recall>=0.9',
    'precision>=0.9',
    'stem_f1>=0.75',
    'plant_accuracy>=0.75',
    'height_median_abs_error<=0.02',
    'stem_diameter_rmse<=0.003',
)


class SimulatedField(ProgramTest):
    def simulate_and_measure(self, *settings):
        """Folders of truth and run."""
        field, run = self.path('field'), self.path('run')
        self.assert_done(self.simulate('--output', field, '--no-bag', *settings))
        self.assert_done(self.measure(self.path('field', 'cloud.pcd'), '-o', run))
        return field, run

    def assert_scores(self, seed, checks, *settings):
        field, run = self.simulate_and_measure('--seed', seed, *settings)
        status, said = self.evaluate('--run', run, '--truth', field, '--check', *checks)
        print('seed {}:\n{}'.format(seed, said))
        self.assertEqual(status, 0, said)

    def plants_found(self, *settings):
        _, run = self.simulate_and_measure(*settings)
        rows, _ = read_table(self.path('run', 'plants.csv'))
        print('{} plants found with {}'.format(len(rows), ' '.join(settings)))
        return len(rows)

    def test_tasselling_fields(self):
        for seed in ('1', '2', '3'):
            with self.subTest(seed=seed):
                self.assert_scores(
                    seed, CHECKS, '--rows', '2', '--plants-per-row', '12', '--points', '200000'
                )

    def test_bare_field(self):
        for seed in ('4', '5'):
            self.assertEqual(
                self.plants_found(
                    '--seed', seed, '--plants-per-row', '0', '--rows', '2',
                    '--bare-length', '6', '--points', '200000',
                ),
                0,
            )  # fmt: skip

    def test_weeds_only(self):
        for seed in ('6', '7'):
            self.assertLessEqual(
                self.plants_found(
                    '--seed', seed, '--plants-per-row', '0', '--rows', '2',
                    '--bare-length', '8', '--weeds', '100', '--points', '400000',
                ),
                2,
            )  # fmt: skip


if __name__ == '__main__':
    unittest.main()
