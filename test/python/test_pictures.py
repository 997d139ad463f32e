import os
import unittest

import matplotlib.colors
import matplotlib.image
import numpy as np

import support
from field_phenotyping_tools import field_picture, growth, growth_picture, tables

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


GROWTH_COLUMNS = (
    'plant_id,x,y,z,quality,iterations,r1,M,alpha,beta,regions,branchings,merged_regions,'
    'stem_points'
).split(',')
REGION_COLUMNS = (
    'plant_id,region,start_x,start_y,start_z,end_x,end_y,end_z,M,branching,merged,points'
).split(',')
COMPLETED = np.dtype(
    [('x', 'f8'), ('y', 'f8'), ('z', 'f8'), ('plant_id', 'i4'), ('synthetic', 'u1')]
)


class PlotGrowth(support.FolderTest):
    def write_grown(self, regions=4, cloud=None, origin=(0.0, 0.0, 0.0)):
        """A run with --debug: plant 4 in regions of equal length, the second at a branching, the
        last not merged; plant 9 in none."""
        cloud = field() if cloud is None else cloud
        run = self.write_run(PLANTS, cloud)
        x, y, z = origin
        summary = {'quality': 0.7321, 'iterations': 3, 'r1': 0.05, 'M': 0.5}
        summary.update({'alpha': 0.25, 'beta': 0.85, 'x': x, 'z': z})
        plants = [dict(summary, plant_id=9, y=y + 2.0), dict(summary, plant_id=4, y=y)]
        support.write_table(self.path('run', 'growth.csv'), GROWTH_COLUMNS, plants)
        rows = [
            {
                'plant_id': 4,
                'region': k,
                'start_x': x,
                'start_y': y,
                'start_z': z + k / regions,
                'end_x': x,
                'end_y': y,
                'end_z': z + (k + 1) / regions,
                'M': 0.4 if k == 1 else 0.5,
                'branching': int(k == 1),
                'merged': int(k < regions - 1),
                'points': 300,
            }
            for k in reversed(range(regions))
        ]
        support.write_table(self.path('run', 'growth_regions.csv'), REGION_COLUMNS, rows)
        stems = cloud[cloud['part'] == 1]
        completed = np.zeros(len(stems) + 1, COMPLETED)
        for name in ('x', 'y', 'z', 'plant_id'):
            completed[name][:-1] = stems[name]
        completed[-1] = (x + 9.0, y, z, 4, 1)  # filled in: not to be drawn
        support.write_pcd(self.path('run', 'completed.pcd'), completed)
        return run

    def draw(self, run, plant=4):
        status, _, err = support.run_program(
            'plot_growth', run, '--plant', str(plant), '--output', self.path('g.png')
        )
        self.assertEqual(status, 0, err)
        return matplotlib.image.imread(self.path('g.png'))[:, :, :3]

    def assert_color(self, image, color, least=20):
        wanted = matplotlib.colors.to_rgb(color)
        near = np.all(np.abs(image - wanted) < 0.03, axis=2)
        self.assertGreater(near.sum(), least, color)

    def test_reads_the_regions_of_the_plant_from_the_base_up(self):
        grown = growth.read_growth(self.write_grown(), 4)
        self.assertEqual(len(grown), 4)
        np.testing.assert_allclose(grown.start[:, 2], [0.0, 0.25, 0.5, 0.75])
        np.testing.assert_allclose(grown.end[:, 2], [0.25, 0.5, 0.75, 1.0])
        np.testing.assert_allclose(grown.M, [0.5, 0.4, 0.5, 0.5])
        self.assertEqual(grown.branching.tolist(), [False, True, False, False])
        self.assertEqual(grown.merged.tolist(), [True, True, True, False])
        self.assertEqual(grown.points.tolist(), [300] * 4)
        self.assertEqual(grown.summary['iterations'], 3.0)
        self.assertEqual(len(growth.read_growth(self.path('run'), 9)), 0)

    def test_every_region_has_its_colour(self):
        image = self.draw(self.write_grown())
        for color in growth_picture._COLORS[:3]:
            self.assert_color(image, color)
        self.assert_color(image, growth_picture._BRANCHING, 1000)
        self.assert_color(image, growth_picture._NOT_MERGED)

    def test_points_go_to_the_region_whose_line_is_nearest(self):
        start = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        end = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 2.0]])
        points = np.array([[0.1, 0.0, 0.5], [0.0, 0.0, -1.0], [0.4, 0.0, 1.6], [0.5, 0.1, 3.0]])
        self.assertEqual(
            growth_picture.nearest_region(points, start, end).tolist(), [0, 0, 1, 1]
        )

    def test_labels_of_thin_regions_are_moved_apart(self):
        heights = growth_picture._spread([0.1, 0.5, 0.505, 0.51, 0.9], 0.02)
        self.assertGreater(np.diff(heights).min(), 0.0199)
        np.testing.assert_allclose(heights[[0, 2, 4]], [0.1, 0.505, 0.9], atol=1e-3)

    def test_odd_runs(self):
        self.draw(self.write_grown(), 9)  # a plant without regions
        self.draw(self.write_grown(regions=1))
        self.draw(self.write_grown(cloud=field()[:3000]))  # nothing but soil
        nan = field()
        nan['x'][nan['part'] == 2] = np.nan
        self.draw(self.write_grown(cloud=nan))
        far = (512000.0, 5.4e6, 90.0)
        self.draw(self.write_grown(cloud=field(far), origin=far))

    def test_bad_input_is_one_clear_error(self):
        run = self.write_run(PLANTS, field())
        output = ['--output', self.path('a.png')]
        for words, arguments in (
            ('without --debug. Run phenotype_cloud CLOUD --output', [run, '--plant', '4']),
            ('No run folder', [self.path('no'), '--plant', '4']),
        ):
            self.assert_refused(words, *arguments, *output)
        self.write_grown()
        for words, arguments in (
            ('has no plant 5; it has ids 4, 9', ['--plant', '5', *output]),
            ('Choose another place', ['--plant', '4', '--output', self.path('no', 'a.png')]),
            ('a name ending in .png', ['--plant', '4', '--output', self.path('a.docx')]),
            ('--plant', output),
        ):
            self.assert_refused(words, run, *arguments)
        for name in ('growth_regions.csv', 'completed.pcd', 'labels.pcd'):
            self.write_grown()
            os.remove(self.path('run', name))
            self.assert_refused(name, run, '--plant', '4', *output)

    def assert_refused(self, words, *arguments):
        status, _, err = support.run_program('plot_growth', *arguments)
        self.assertEqual((status, 'Traceback' in err), (2, False), err)
        self.assertIn(words, err)


class IdList(unittest.TestCase):
    def test_names_runs_of_ids(self):
        self.assertEqual(tables.id_list([]), 'none')
        self.assertEqual(tables.id_list([7, 2, 1, 4, 3]), 'ids 1 to 4, 7')


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
