"""Fields put together of single plants."""

import os
import tempfile
import unittest

import numpy as np
import support  # noqa: F401 - the package's path
from field_phenotyping_tools import pcd, planted_field, tables

SIZE = 6000
HEADER = (
    'VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {0}\nHEIGHT 1\n'
    'POINTS {0}\nDATA ascii\n'
)


def write_pole(path, height):
    """A pole of 3 cm radius that does not stand at the origin, nor at height 0."""
    angle, z = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40), np.linspace(0.0, height, 200))
    points = np.column_stack(
        [5.0 + 0.03 * np.cos(angle.ravel()), 7.0 + 0.03 * np.sin(angle.ravel()), 2.0 + z.ravel()]
    )
    with open(path, 'w') as file:
        file.write(HEADER.format(len(points)))
        np.savetxt(file, points, '%.4f')


class PlantedField(unittest.TestCase):
    def setUp(self):
        self._folder = tempfile.TemporaryDirectory()
        self.addCleanup(self._folder.cleanup)
        source = os.path.join(self._folder.name, 'pole.pcd')
        write_pole(source, 1.0)
        self.layout = planted_field.Layout(2, 3, 0.75, 0.4)
        self.field = os.path.join(self._folder.name, 'field')
        planted_field.plant_field(self.field, [source], self.layout, 1, 0.0, SIZE)
        self.cloud = pcd.read_pcd(os.path.join(self.field, 'cloud.pcd'))
        self.truth = tables.read_table(os.path.join(self.field, 'truth.csv'), ('plant_id',))

    def test_plants_stand_where_the_truth_says(self):
        self.assertEqual(list(self.truth['plant_id']), list(range(6)))
        self.assertEqual(list(self.truth['row']), [0, 0, 0, 1, 1, 1])
        for plant in range(6):
            of_plant = self.cloud[self.cloud['plant_id'] == plant]
            self.assertGreater(len(of_plant), 50)
            away = np.hypot(
                of_plant['x'] - self.truth['x'][plant], of_plant['y'] - self.truth['y'][plant]
            )
            self.assertLess(away.max(), 0.03 * 1.1 + 1e-3)
            # The head of a pole is always seen.
            self.assertAlmostEqual(of_plant['z'].max(), self.truth['height'][plant], delta=0.03)
        self.assertGreater(self.truth['height'].min(), 0.9)
        self.assertLess(self.truth['height'].max(), 1.1)
        self.assertGreater(np.ptp(self.truth['height']), 0.01)

    def test_there_is_soil(self):
        soil = self.cloud[self.cloud['plant_id'] < 0]
        self.assertGreater(len(soil), 500)
        self.assertLess(np.abs(soil['z']).max(), 0.011)

    def test_as_many_points_as_asked_for(self):
        # No point twice, so somewhat fewer where beams are close.
        self.assertLess(len(self.cloud), 1.05 * SIZE)
        self.assertGreater(len(self.cloud), 0.8 * SIZE)

    def test_the_same_for_the_same_seed(self):
        source = os.path.join(self._folder.name, 'pole.pcd')
        again = os.path.join(self._folder.name, 'again')
        planted_field.plant_field(again, [source], self.layout, 1, 0.0, SIZE)
        np.testing.assert_array_equal(
            self.cloud, pcd.read_pcd(os.path.join(again, 'cloud.pcd'))
        )


if __name__ == '__main__':
    unittest.main()
