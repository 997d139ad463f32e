import contextlib
import io
import os
import unittest
from unittest import mock

import support
from field_phenotyping_tools import benchmarks, pipeline_benchmark


def timed(stage, method, *seconds, found=1):
    return {
        'stage': stage, 'method': method, 'points': 9, 'found': found, 'seconds': list(seconds),
    }  # fmt: skip


class Comparison(unittest.TestCase):
    def test_parts_of_one_method_add_up_and_are_told_as_ratios_to_ours(self):
        rows = [
            timed('voxel grid', 'pcl::VoxelGrid', 6.0, 7.0, 100.0),
            timed('voxel grid', 'ours', 2.0, 1.0, 9.0),
            timed('segmentation', 'pcl::NormalEstimationOMP, some, all cores', 1.0),
            timed('segmentation', 'pcl::NormalEstimationOMP, some, one core', 3.0),
            timed('segmentation', 'pcl::RegionGrowing, some', 2.0, found=5),
            timed('segmentation', 'ours, one core', 4.0),
        ]
        figures = pipeline_benchmark.compare_stages(rows)
        self.assertEqual(
            [(label, row['median_s'], row['ratio']) for label, row in figures.items()],
            [
                ('voxel grid, ours', 2.0, 1.0),
                ('voxel grid, pcl::VoxelGrid', 7.0, 3.5),
                ('segmentation, ours, one core', 4.0, 1.0),
                (
                    'segmentation, pcl::NormalEstimationOMP (all cores) + RegionGrowing, some',
                    3.0,
                    0.75,
                ),
                (
                    'segmentation, pcl::NormalEstimationOMP (one core) + RegionGrowing, some',
                    5.0,
                    1.25,
                ),
            ],
        )
        self.assertEqual(list(figures.values())[-1]['found'], 5)


class Floors(unittest.TestCase):
    def test_least_work_follows_from_the_counts(self):
        work = dict.fromkeys(
            ('points', 'voxels', 'soil_points', 'plant_points', 'neighbours', 'stem_points')
            + ('filled_points', 'diameter_points', 'min_neighbors'),
            0,
        )
        self.assertTrue(all(p == (0, 0) for p in pipeline_benchmark.least_work(work).values()))
        work.update(points=100, voxels=50, min_neighbors=2, neighbours=7)
        least = pipeline_benchmark.least_work(work)
        self.assertEqual(least['voxel grid'], (100 * 12 + 50 * 16, 1600))
        self.assertEqual(least['outliers'], (50 * 13, 50 * 3 * 8))
        self.assertEqual(least['segmentation'], (0, 7 * 26))
        self.assertEqual(least['soil'], (0, 0))


class Goals(unittest.TestCase):
    def test_each_figure_stands_beside_its_goal(self):
        beside = {
            'whole pipeline, ours, one core': {'median_s': 3.0},
            'segmentation, pcl::NormalEstimationOMP (one core) + RegionGrowing, whole cloud': {
                'median_s': 12.0
            },
            'voxel grid, pcl::VoxelGrid, tile by tile': {'ratio': 2.0},
            'soil, pcl::SACSegmentation': {'ratio': 5.5},
        }
        figures = {
            'stages': {'ripe, all cores': {'points': 1200000, 'median_s': 1.9, 'gpu': False}},
            'rivals': beside,
            'cores': {'2': {'speedup': 1.8}},
            'plants': {'8 x': {'time_ratio': 9.0, 'memory_ratio': 8.0}},
        }
        rows = pipeline_benchmark.goals(figures)
        self.assertEqual(
            [(value, reached) for _, _, value, reached in rows],
            [
                ('1.90 s', True),
                ('0.25 x', True),
                ('2.00 x', False),
                ('5.50 x', True),
                ('1.80 x', True),
                ('9.00 x', False),
                ('8.00 x', True),
                ('no GPU here', False),
            ],
        )
        self.assertEqual(pipeline_benchmark.goals({}), [])


class Document(support.FolderTest):
    def test_what_is_printed_is_kept_with_its_frame(self):
        report = benchmarks.Report(
            lambda bench: print('# Title, quick {}'.format(bench.quick)),
            lambda figures: print('closing {}'.format(figures['one'])),
        )
        path = self.path('docs', 'report.md')
        arguments = ['--quick', '--report', path, '--output', self.path('figures')]

        def table(bench, folder):
            self.assertEqual(folder, os.path.dirname(path))
            print('row')
            return 7

        out = io.StringIO()
        with mock.patch('sys.argv', ['program'] + arguments), contextlib.redirect_stdout(out):
            status = benchmarks.main(
                'program', '', {'one': table}, 'pictures', 'figures.json', 'a second', report
            )
        self.assertEqual(status, 0)
        with open(path) as file:
            self.assertEqual(file.read(), '# Title, quick True\nrow\nclosing 7\n')
        self.assertIn('closing 7', out.getvalue())
        self.assertTrue(os.path.isfile(self.path('figures', 'figures.json')))


if __name__ == '__main__':
    unittest.main()
