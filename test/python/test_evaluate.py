import csv
import json
import math
import os
import re
import unittest

import numpy as np

import support
from field_phenotyping_tools import evaluation, reporting
from field_phenotyping_tools.errors import InputError

TRUTH = [
    {
        'plant_id': 10,
        'x': 0.0,
        'y': 0.0,
        'height': 2.00,
        'stem_diameter': 0.020,
        'visible_points': 900,
    },
    {
        'plant_id': 11,
        'x': 0.2,
        'y': 0.0,
        'height': 2.10,
        'stem_diameter': 0.022,
        'visible_points': 800,
    },
    {
        'plant_id': 12,
        'x': 0.4,
        'y': 0.0,
        'height': 2.20,
        'stem_diameter': 0.024,
        'visible_points': 700,
    },
    {
        'plant_id': 13,
        'x': 0.6,
        'y': 0.0,
        'height': 2.30,
        'stem_diameter': 0.026,
        'visible_points': 5,
    },
]
# 10 found 1 cm off, 11 found exactly with no diameter, 12 missed (found 7 cm away), 13 found.
RUN = [
    {'plant_id': 3, 'x': 0.01, 'y': 0.0, 'height': 2.03, 'stem_diameter': 0.021},
    {
        'plant_id': 1,
        'x': 0.2,
        'y': 0.0,
        'height': 2.09,
        'stem_diameter': 'nan',
        'stem_diameter_stddev': 'nan',
        'quality': 'too_few_points|low_confidence',
    },
    {'plant_id': 7, 'x': 0.4, 'y': 0.07, 'height': 9.0, 'stem_diameter': 0.9},
    {'plant_id': 2, 'x': 0.6, 'y': 0.0, 'height': 2.30, 'stem_diameter': 0.023},
]
# x, truth id, truth part, id in the run, part in the run; 5 mm apart
POINTS = [
    (0.000, 10, 1, 3, 1),
    (0.005, 10, 1, 3, 1),
    (0.010, 10, 2, 3, 2),
    (0.015, 10, 2, 3, 1),
    (0.200, 11, 1, 1, 1),
    (0.205, 11, 2, 3, 2),
    (0.400, 12, 1, 7, 1),
    (0.405, 12, 2, 7, 2),
    (0.500, -1, 0, 7, 1),
    (0.505, -1, 0, -1, 0),
]


def clouds():
    positions = [(point[0], 0.0, 0.5) for point in POINTS]
    columns = list(zip(*POINTS))
    return (
        support.labelled(positions, columns[1], columns[2]),
        support.labelled(positions, columns[3], columns[4]),
    )


class Field(support.FolderTest):
    def evaluate(self, run=RUN, truth=TRUTH, truth_cloud=None, labels=None, **options):
        return evaluation.evaluate(
            evaluation.Run(self.write_run(run, labels)),
            self.write_truth(truth, truth_cloud),
            **options,
        )

    def assert_figures(self, report, **expected):
        for name, value in expected.items():
            self.assertAlmostEqual(report.figures[name], value, msg=name)

    def test_plants(self):
        self.assert_figures(
            self.evaluate(),
            truth_plants=4,
            found_plants=4,
            matched=3,
            missed=1,
            false_plants=1,
            recall=0.75,
            precision=0.75,
            plant_f1=0.75,
            match_radius=0.06,
            base_error_median=0.0,
            base_error_max=0.01,
            confident_plants=3,
        )

    def test_traits_of_the_matched_plants_only(self):
        report = self.evaluate()
        # height errors 3, -1, 0 cm with a standard deviation of 1 cm
        self.assert_figures(
            report,
            height_n=3,
            height_rmse=math.sqrt(10 / 3) / 100,
            height_mae=0.04 / 3,
            height_bias=0.02 / 3,
            height_median_abs_error=0.01,
            height_coverage=2 / 3,
        )
        # diameter errors 1 and -3 mm with 1 mm; the third was not measured
        self.assert_figures(
            report,
            stem_diameter_n=2,
            stem_diameter_rmse=math.sqrt(5) / 1000,
            stem_diameter_bias=-0.001,
            stem_diameter_coverage=0.5,
            stem_diameter_r2=1 - 10 / 18,
        )

    def test_match_radius(self):
        self.assert_figures(self.evaluate(match_radius=0.08), matched=4, recall=1.0)

    def test_plants_the_scanner_hardly_saw_count_unless_left_out(self):
        report = self.evaluate(min_truth_points=100)
        self.assert_figures(
            report,
            truth_plants=3,
            matched=2,
            recall=2 / 3,
            false_plants=1,
            precision=2 / 3,
            height_n=2,
        )
        self.assertIn('1 of 4 true plants have under 100 points', report.notes[0])
        self.assertEqual(report.rows[3]['status'], 'left out')

    def test_points_are_counted_in_the_cloud_where_the_table_does_not_say(self):
        truth = self.write_truth(TRUTH, clouds()[0])
        columns = [name for name in support.TRUTH_COLUMNS if name != 'visible_points']
        support.write_table(os.path.join(truth, 'truth.csv'), columns, TRUTH)
        run = evaluation.Run(self.write_run(RUN))
        report = evaluation.evaluate(run, truth, min_truth_points=2)
        self.assert_figures(report, truth_plants=3)  # plant 13 has no point
        os.remove(os.path.join(truth, 'cloud.pcd'))
        with self.assertRaisesRegex(InputError, 'visible_points'):
            evaluation.evaluate(run, truth, min_truth_points=2)

    def test_labels(self):
        truth_cloud, labels = clouds()
        report = self.evaluate(truth_cloud=truth_cloud, labels=labels)
        # stem: 4 right, 1 organ and 1 ground point claimed, none missed
        self.assert_figures(
            report,
            stem_precision=4 / 6,
            stem_recall=1.0,
            stem_f1=0.8,
            stem_iou=4 / 6,
            stem_on_ground_points=1,
            sa=7 / 8,
        )
        # boundary: 0.000 0.005 | 0.010 0.015, 0.200 | 0.205, 0.400 | 0.405; said stem: 5, right: 4
        self.assert_figures(report, bp=0.8, boundary_points=8)
        # right: 4 of plant 10, 1 of 11; plant 12 was not matched
        self.assert_figures(report, plant_accuracy=5 / 8, plant_points=8)

    def test_a_live_run_has_no_labels(self):
        report = self.evaluate(truth_cloud=clouds()[0])
        self.assertNotIn('stem_f1', report.figures)
        self.assertIn('no labels.pcd', report.notes[-1])

    def test_labels_of_another_cloud(self):
        truth_cloud, labels = clouds()
        with self.assertRaisesRegex(InputError, 'has 9 points.* has 10.*Run phenotype_cloud on'):
            self.evaluate(truth_cloud=truth_cloud, labels=labels[:9])
        with self.assertRaisesRegex(InputError, 'different points, the first at index 0'):
            self.evaluate(truth_cloud=truth_cloud, labels=labels[::-1].copy())

    def test_invalid_points_stay_in_step(self):
        truth_cloud, labels = clouds()
        truth_cloud['x'][9] = labels['x'][9] = np.nan
        self.assert_figures(self.evaluate(truth_cloud=truth_cloud, labels=labels), stem_f1=0.8)

    def test_coordinates_far_from_the_origin(self):
        def moved(plants):
            return [dict(plant, x=plant['x'] + 512345.5, y=plant['y'] + 5.4e6) for plant in plants]

        def wide(cloud):
            kind = np.dtype([('x', 'f8'), ('y', 'f8')] + support.LABELS.descr[2:])
            cloud = cloud.astype(kind)
            cloud['x'] += 512345.5
            cloud['y'] += 5.4e6
            return cloud

        truth_cloud, labels = map(wide, clouds())
        report = self.evaluate(moved(RUN), moved(TRUTH), truth_cloud, labels)
        self.assert_figures(report, matched=3, bp=0.8, boundary_points=8, stem_f1=0.8)

    def test_a_run_without_plants(self):
        truth_cloud, labels = clouds()
        labels['plant_id'], labels['part'] = -1, 0
        report = self.evaluate([], truth_cloud=truth_cloud, labels=labels)
        self.assert_figures(
            report, recall=0.0, plant_f1=0.0, missed=4, stem_f1=0.0, plant_accuracy=0.0
        )
        self.assertTrue(math.isnan(report.figures['precision']))
        self.assertTrue(math.isnan(report.figures['height_rmse']))
        self.assertIn('recall 0.000   precision -', reporting.format_report(report))

    def test_a_field_without_plants(self):
        self.assert_figures(self.evaluate(truth=[]), precision=0.0, false_plants=4, missed=0)
        self.assertTrue(math.isnan(self.evaluate(truth=[]).figures['recall']))
        self.assert_figures(self.evaluate([], []), found_plants=0, false_plants=0)

    def test_diameters_taken_at_another_height_are_told(self):
        run = [dict(RUN[0], diameter_height=0.4)] + RUN[1:]
        self.assertIn('1 of 3 diameters', self.evaluate(run).notes[0])

    def test_worst_plants_come_first(self):
        rows = reporting.worst_plants(self.evaluate().rows, 4)
        self.assertEqual(
            [(row['status'], row.get('truth_id')) for row in rows],
            [('missed', 12), ('false', None), ('matched', 10), ('matched', 13)],
        )


class OtherTruths(support.FolderTest):
    def test_labelled_points_of_a_single_plant(self):
        truth_cloud, labels = clouds()
        support.write_pcd(self.path('plant.pcd'), truth_cloud[['x', 'y', 'z', 'part']].copy())
        report = evaluation.evaluate(
            evaluation.Run(self.write_run(RUN[:1], labels)), self.path('plant.pcd')
        )
        self.assertAlmostEqual(report.figures['stem_f1'], 8 / 9)  # the ground point is not labelled
        self.assertNotIn('recall', report.figures)
        self.assertEqual(report.figures['found_plants'], 1)

    def test_cloud_without_labels(self):
        truth_cloud, labels = clouds()
        truth_cloud['part'] = 0
        support.write_pcd(self.path('plant.pcd'), truth_cloud)
        report = evaluation.evaluate(
            evaluation.Run(self.write_run(RUN, labels)), self.path('plant.pcd')
        )
        self.assertIn('no point of', report.notes[0])

    def test_axes(self):
        with open(self.path('axes.csv'), 'w') as file:
            file.write(
                'plant,x,y,z,axis_x,axis_y,axis_z\n'
                '0,0.05,0,1,0,0,1\n1,0.6,0,1,0,0,1\n2,5,0,1,0,0,1\n'
            )
        run = [dict(plant, z=0.0) for plant in RUN]
        report = evaluation.evaluate(evaluation.Run(self.write_run(run)), self.path('axes.csv'))
        self.assertEqual(
            [report.figures[name] for name in ('matched', 'missed', 'false_plants')], [2, 1, 2]
        )
        self.assertAlmostEqual(report.figures['base_error_max'], 0.04)

    def test_run_by_itself(self):
        figures = evaluation.describe(evaluation.Run(self.write_run(RUN))).figures
        self.assertEqual((figures['found_plants'], figures['measured_diameters']), (4, 3))
        self.assertEqual(figures['tallest_plant'], 9.0)


class Compare(support.FolderTest):
    def test_differences(self):
        other = [
            dict(RUN[0], plant_id=50, z=0.02, height=2.02),
            dict(RUN[1], stem_diameter=0.02),
            dict(RUN[2], x=9.0),
        ]
        report = evaluation.compare(
            evaluation.Run(self.write_run(RUN)), evaluation.Run(self.write_run(other, name='other'))
        )
        figures = report.figures
        self.assertEqual(
            [figures[name] for name in ('matched', 'only_in_run', 'only_in_other')], [2, 2, 1]
        )
        self.assertAlmostEqual(figures['position_max'], 0.02)
        self.assertAlmostEqual(figures['height_max'], 0.01)
        self.assertAlmostEqual(figures['height_median'], 0.005)
        self.assertAlmostEqual(figures['stem_diameter_max'], 0.0)
        self.assertEqual(figures['stem_diameter_in_one_only'], 1)
        self.assertEqual(
            sorted(row['status'] for row in report.rows),
            ['matched'] * 2 + ['only in other'] + ['only in run'] * 2,
        )


class Program(support.FolderTest):
    def test_everything_it_writes(self):
        truth_cloud, labels = clouds()
        run, truth = self.write_run(RUN, labels), self.write_truth(TRUTH, truth_cloud)
        status, out, err = support.run_program(
            'evaluate',
            '--run',
            run,
            '--truth',
            truth,
            '--table',
            '--output',
            self.path('out', 'plots'),
            '--json',
            self.path('scores.json'),
            '--check',
            'recall>=0.75',
            'height_rmse<0.02',
        )
        self.assertEqual((status, [line for line in err.split('\n') if 'error' in line]), (0, []))
        self.assertIn('recall 0.750   precision 0.750', out)
        self.assertIn('no further apart than 6.0 cm', out)
        self.assertRegex(out, r'stem diameter, major +mm +2 +0.444 ')
        self.assertIn('BP 0.800', out)
        self.assertRegex(
            out, r'10 +3 +0.00 +0.00 +203.0 +200.0 +3.0 +1.0 +21.0 +20.0 +1.0 +1.0 +matched'
        )
        self.assertIn('matched (too_few_points|low_confidence)', out)
        for name in ('height.png', 'stem_diameter.png', 'field_errors.png', 'coverage.png'):
            with open(self.path('out', 'plots', name), 'rb') as file:
                self.assertEqual(file.read(8), b'\x89PNG\r\n\x1a\n')
        with open(self.path('out', 'plots', 'worst_plants.csv'), newline='') as file:
            worst = list(csv.DictReader(file))
        self.assertEqual([row['status'] for row in worst][:2], ['missed', 'false'])
        self.assertEqual(worst[0]['stem_diameter'], 'nan')
        with open(self.path('scores.json')) as file:
            scores = json.load(file)
        self.assertEqual(scores['figures']['recall'], 0.75)
        self.assertIsNone(scores['plants'][1]['stem_diameter'])

    def test_failed_check(self):
        status, out, _ = support.run_program(
            'evaluate',
            '--run',
            self.write_run(RUN),
            '--truth',
            self.write_truth(TRUTH),
            '--check',
            'recall>=0.95',
            '--check',
            'precision>=0.5',
            '--check',
            'stem_f1>=0.8',
        )
        self.assertEqual(status, 1)
        self.assertIn('CHECK FAILED  recall>=0.95: recall is 0.75', out)
        self.assertIn('CHECK FAILED  stem_f1>=0.8: no figure stem_f1', out)
        self.assertEqual(out.count('CHECK FAILED'), 2)

    def test_no_plants_at_all(self):
        for truth in (TRUTH, []):
            status, out, err = support.run_program(
                'evaluate',
                '--run',
                self.write_run([]),
                '--truth',
                self.write_truth(truth),
                '--table',
                '--output',
                self.path('out'),
                '--json',
                self.path('scores.json'),
            )
            self.assertEqual((status, 'Traceback' in err), (0, False), err)
            self.assertIn('found 0', out)

    def test_table_without_truth_and_of_two_runs(self):
        run = self.write_run(RUN)
        status, out, _ = support.run_program('evaluate', '--run', run, '--table')
        self.assertEqual((status, len(re.findall(r' found( \(.*\))?\n', out))), (0, 4))
        status, out, _ = support.run_program(
            'evaluate',
            '--run',
            run,
            '--compare',
            run,
            '--table',
            '--check',
            'position_max<=0',
            'only_in_run==0',
        )
        self.assertEqual((status, out.count(' matched\n')), (0, 3))

    def assert_refused(self, words, *arguments):
        status, out, err = support.run_program('evaluate', *arguments)
        self.assertEqual((status, out, err.count('error')), (2, '', 1), err)
        self.assertIn(words, err)
        self.assertNotIn('Traceback', err)

    def test_bad_input_is_one_clear_error(self):
        run, truth = self.write_run(RUN), self.write_truth(TRUTH)
        os.makedirs(self.path('empty'))
        self.assert_refused('No run folder', '--run', self.path('nowhere'))
        self.assert_refused('has no plants.csv', '--run', self.path('empty'))
        self.assert_refused('truth.csv: No such file', '--run', run, '--truth', self.path('empty'))
        self.assert_refused('No such file', '--run', run, '--truth', self.path('a.pcd'))
        self.assert_refused('Cannot read the check', '--run', run, '--check', 'recall')
        self.assert_refused(
            'must be above 0', '--run', run, '--truth', truth, '--match-radius', '0'
        )
        self.assert_refused('not allowed with', '--run', run, '--truth', truth, '--compare', run)
        status, _, err = support.run_program(
            'evaluate', '--run', run, '--json', self.path('no', 'dir.json')
        )
        self.assertEqual(status, 2)
        self.assertRegex(err, 'cannot write .*dir.json: No such file.* Choose another place')

    def test_bad_tables_are_one_clear_error(self):
        run, table = self.write_run(RUN), self.path('run', 'plants.csv')
        for content, words in (
            ('', 'is empty'),
            ('a,b\n1,2\n', 'no column plant_id'),
            ('plant_id,x,y,z\n1,2,3\n', 'row 2 has 3 cells'),
            ('plant_id,x,y,z\n1,2,3,far\n', 'column z must hold numbers'),
            ('plant_id,x,y,z\n1,2,3,4\n1,2,3,5\n', 'plant_id 1 is given 2 times'),
            ('plant_id,x,y,z\n1.5,2,3,4\n', 'whole numbers'),
            ('plant_id,x,y,z\nnan,2,3,4\n', 'whole numbers'),
            ('\0\xff\xfe', 'plants.csv'),
        ):
            with open(table, 'w', encoding='latin-1') as file:
                file.write(content)
            self.refused_without_output(words, run)

    def refused_without_output(self, words, run):
        status, out, err = support.run_program('evaluate', '--run', run)
        self.assertEqual((status, out), (2, ''), err)
        self.assertIn(words, err)
        self.assertNotIn('Traceback', err)


if __name__ == '__main__':
    unittest.main()
