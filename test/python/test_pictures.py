import unittest

import matplotlib.image
import numpy as np

import support
from field_phenotyping_tools import field_picture

PLANTS = [
    {
        'plant_id': 4,
        'x': 0.0,
        'y': 0.0,
        'height': 1.0,
        'stem_diameter': 0.030,
        'stem_diameter_minor': 0.020,
        'diameter_height': 0.5,
    },
    {'plant_id': 9, 'x': 0.0, 'y': 2.0, 'stem_diameter': 'nan', 'diameter_height': 'nan'},
]


def field(origin=(0.0, 0.0, 0.0)):
    """Two cylinders, each below a ball of leaves, on flat ground."""
    random = np.random.RandomState(2)
    positions, plant, part = (
        [random.rand(3000, 3) * [1.0, 3.0, 0.0] - [0.5, 0.5, 0.0]],
        [-1] * 3000,
        [0] * 3000,
    )
    for number, y in ((4, 0.0), (9, 2.0)):
        angle, height = random.rand(2, 1000)
        stem = np.column_stack(
            [0.015 * np.cos(6.2832 * angle), 0.010 * np.sin(6.2832 * angle) + y, height]
        )
        positions += [stem, random.randn(500, 3) * 0.1 + [0.0, y, 1.0]]
        plant += [number] * 1500
        part += [1] * 1000 + [2] * 500
    cloud = support.labelled(np.concatenate(positions) + np.array(origin), plant, part)
    return cloud


class PlotField(support.FolderTest):
    def draw(self, *arguments, plants=PLANTS, cloud=None):
        run = self.write_run(plants, field() if cloud is None else cloud)
        status, _, err = support.run_program(
            'plot_field', run, '--output', self.path('f.png'), *arguments
        )
        self.assertEqual(status, 0, err)
        return matplotlib.image.imread(self.path('f.png'))[:, :, :3]

    def test_colours_of_the_parts_are_in_the_picture(self):
        image = self.draw('--view', 'top')
        self.assertGreater(image.shape[1], image.shape[0])  # the long edge lies flat
        both = self.draw()
        self.assertGreater(both.shape[0], image.shape[0])
        for color in (
            (0.62, 0.62, 0.62),
            field_picture._plant_color(4),
            field_picture._plant_color(9),
        ):
            near = np.all(np.abs(both - color) < 0.03, axis=2)
            self.assertGreater(near.sum(), 20, color)

    def test_one_plant(self):
        self.assertGreater(np.ptp(self.draw('--plant', '4')), 0.5)
        self.assertGreater(np.ptp(self.draw('--plant', '9')), 0.5)  # no diameter measured

    def test_odd_clouds(self):
        nan = field()
        nan['x'][5] = np.nan
        for cloud in (nan, field()[:0], field()[:3000], field((512000.0, 5.4e6, 90.0))):
            self.draw(cloud=cloud)
            self.draw('--plant', '4', cloud=cloud)
        self.draw(plants=[])

    def test_bad_input_is_one_clear_error(self):
        run = self.write_run(PLANTS)
        for words, arguments in (
            ('has no labels.pcd', [run, '--output', self.path('a.png')]),
            ('No run folder', [self.path('no'), '--output', self.path('a.png')]),
        ):
            status, _, err = support.run_program('plot_field', *arguments)
            self.assertEqual((status, 'Traceback' in err), (2, False), err)
            self.assertIn(words, err)
        self.write_run(PLANTS, field())
        for words, arguments in (
            ('has no plant 5; it has ids 4, 9', ['--plant', '5']),
            ('Choose another place', ['--output', self.path('no', 'a.png')]),
            ('a name ending in .png', ['--output', self.path('a.docx')]),
        ):
            status, _, err = support.run_program(
                'plot_field', run, '--output', self.path('a.png'), *arguments
            )
            self.assertEqual((status, 'Traceback' in err), (2, False), err)
            self.assertIn(words, err)


class EllipsePlacement(unittest.TestCase):
    def test_finds_centre_and_direction_from_half_the_outline(self):
        random = np.random.RandomState(4)
        for angle in (0.1, 0.8, 1.6, 2.4, 3.0):
            t = np.linspace(-1.2, 1.9, 120)
            u, v = 0.016 * np.cos(t), 0.010 * np.sin(t)
            points = np.column_stack(
                [
                    np.cos(angle) * u - np.sin(angle) * v + 0.3,
                    np.sin(angle) * u + np.cos(angle) * v - 0.2,
                ]
            )
            points += random.randn(120, 2) * 0.0003
            points[:6] += 0.02  # leaf points
            centre, found = field_picture.fit_placement(points, 0.016, 0.010)
            np.testing.assert_allclose(centre, [0.3, -0.2], atol=5e-4)
            self.assertLess(abs(np.sin(found - angle)), 0.15)


if __name__ == '__main__':
    unittest.main()
