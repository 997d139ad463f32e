"""The pipeline's benchmark over fields of a few plants; seconds are not looked at here."""

import os
import shutil
import unittest

from program_support import ProgramTest

from field_phenotyping_tools import pipeline_benchmark
from field_phenotyping_tools.pipeline_benchmark import Size

FIELD = Size(1, 2, 12000, 1)


class BenchmarkPipeline(ProgramTest):
    def test_growth_stages(self):
        names = ('jointing', 'ripe')
        rows, said = self.printed(pipeline_benchmark.stages, size=FIELD, names=names)
        for stage in names:
            one, both = rows[stage + ', one core'], rows[stage + ', all cores']
            self.assertEqual(one['points'], 12000)
            self.assertEqual(both['same_plants'], 'yes')
            self.assertGreater(one['median_s'], 0.0)
            self.assertGreaterEqual(one['truth_plants'], 2)
        self.assertEqual(rows['ripe, one core']['matched'], 2)
        self.assertLess(rows['ripe, one core']['height_rmse'], 0.1)
        self.assertTrue('there is no GPU here' in said or any('cuda' in label for label in rows))
        self.assertTrue(os.path.isfile(self.path('pipeline_stages.png')))

    def test_rivals(self):
        rows, said = self.printed(pipeline_benchmark.rivals, size=FIELD, every_stem=1)
        ours = rows['voxel grid, ours, tile by tile']
        theirs = rows['voxel grid, pcl::VoxelGrid, tile by tile']
        self.assertLess(ours['found'], 12000)
        self.assertLess(abs(ours['found'] - theirs['found']), 0.001 * ours['found'])
        self.assertEqual(ours['ratio'], 1.0)
        soil, plane = rows['soil, ours'], rows['soil, pcl::SACSegmentation']
        self.assertEqual(soil['points'], plane['points'])
        self.assertLess(abs(soil['found'] - plane['found']), 0.1 * soil['points'])
        self.assertEqual(rows['segmentation, ours, one core']['found'], 2)
        completed = [row for label, row in rows.items() if label.startswith('completion')]
        self.assertEqual(len(completed), 2)
        for row in completed:
            self.assertGreater(row['found'], 0)
        self.assertIn('32-bit', said)
        self.assertTrue(os.path.isfile(self.path('pipeline_rivals.png')))

    def test_scaling_and_memory(self):
        rows, _ = self.printed(
            pipeline_benchmark.plants, shapes={1: (1, 1), 8: (1, 8)}, repeats=1
        )
        self.assertEqual(rows['8 x']['points'], 8 * rows['1 x']['points'])
        self.assertGreater(rows['8 x']['time_ratio'], 1.0)
        self.assertGreater(rows['8 x']['memory_ratio'], 1.0)
        rows, _ = self.printed(
            pipeline_benchmark.points, counts=(5000, 20000), repeats=1, shape=(1, 2)
        )
        self.assertEqual([row['points'] for row in rows.values()], [5000, 20000])
        rows, _ = self.printed(pipeline_benchmark.cores, size=FIELD, most=2)
        self.assertEqual(list(rows), ['1', '2'])
        rows, _ = self.printed(pipeline_benchmark.memory, size=FIELD)
        held = [row['bytes'] for row in rows.values()]
        self.assertEqual(held, sorted(held))
        self.assertGreater(held[0], 0.0)

    def test_floors(self):
        rows, _ = self.printed(pipeline_benchmark.floors, size=FIELD)
        for stage, row in rows.items():
            self.assertGreater(row['bytes'], 0.0, stage)
            self.assertGreater(row['of_floor'], 1.0, stage)
        self.assertGreaterEqual(rows['voxel grid']['bytes'], 12 * 12000)

    @unittest.skipIf(shutil.which('valgrind') is None, 'valgrind is not installed')
    def test_instructions(self):
        rows, _ = self.printed(pipeline_benchmark.instructions, size=Size(1, 1, 3000, 1))
        shares = [row['share'] for row in rows.values()]
        self.assertEqual(shares[0], 1.0)
        self.assertGreater(rows['whole pipeline']['instructions'], 1e6)
        self.assertGreater(sum(shares[1:]), 0.5)
        self.assertLess(sum(shares[1:]), 1.0)

    def test_command_line(self):
        self.assert_benchmark_command_line('benchmark_pipeline', pipeline_benchmark.TABLES)
        refused = self.run_program('TIME_STAGES', 'memory', '-o', self.path('rows.json'))
        self.assert_refused(refused, 'memory needs a cloud')


if __name__ == '__main__':
    unittest.main()
