import contextlib
import io
import json
import os
import unittest
from unittest import mock

import numpy as np

import support
from field_phenotyping_tools import benchmarks, segmentation_benchmark, stem_truth
from field_phenotyping_tools.errors import InputError
from field_phenotyping_tools.segmentation_scores import NO_PART, OTHER_ORGAN, STEM


class FakeBench:
    """Stands in for the programs: every run is on one plant, and M spoils its labels evenly."""

    def __init__(self, test):
        self.test = test
        self.runs = 0
        positions = np.column_stack([np.zeros(100), np.zeros(100), np.linspace(0.0, 1.0, 100)])
        self.truth = support.labelled(positions, [0] * 100, [STEM] * 50 + [OTHER_ORGAN] * 50)

    def progress(self, text):
        pass

    def simulate(self, *settings):
        return self.test.write_truth([{'plant_id': 0, 'x': 0.0, 'y': 0.0}], self.truth)

    def measure(self, cloud, *settings):
        self.runs += 1
        labels = self.truth.copy()
        name, _, value = dict(zip(settings[::2], settings[1::2])).get('--set', '').partition('=')
        if name == 'segmentation/M':
            labels['part'][: int(100 * float(value) / 2)] = OTHER_ORGAN
        run = self.test.write_run(
            [{'plant_id': 7, 'x': 0.01, 'y': 0.0}], labels, 'run{}'.format(self.runs)
        )
        with open(os.path.join(run, 'timing.json'), 'w') as file:
            seconds = {'preprocessing': 1.0, 'segmentation': 2.0 * self.runs}
            json.dump({stage: {'seconds': s, 'points': 9} for stage, s in seconds.items()}, file)
        return run

    def cluster(self, cloud, method, *settings):
        run = self.measure(cloud)
        result = {
            'settings': {'neighbours': 30},
            'rule': {'max_tilt_deg': 15.0},
            'seconds': {'preprocessing': 1.5, 'normals': 0.25, 'clustering': 0.5, 'rule': 0.25},
        }
        with open(os.path.join(run, 'result.json'), 'w') as file:
            json.dump(result, file)
        return run


def printed(table, *arguments, **keywords):
    """Figures and printed lines of a table."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        rows = table(*arguments, **keywords)
    return rows, out.getvalue().splitlines()


class Tables(support.FolderTest):
    def test_columns_line_up_and_what_is_not_known_is_a_dash(self):
        columns = (
            ('recall [-]', benchmarks.figure('recall', decimals=3)),
            ('base [cm]', benchmarks.figure('base', 100.0, 1)),
        )
        _, lines = printed(benchmarks.print_header, 'field', columns)
        self.assertEqual(lines[1:], ['| field | recall [-] | base [cm] |', '|---|---|---|'])
        _, lines = printed(benchmarks.print_row, 'a', columns, {'recall': np.nan, 'base': 0.0123})
        self.assertEqual(lines, ['| a | - | 1.2 |'])
        _, lines = printed(benchmarks.print_row, 'a', columns, {'recall': 1.0})
        self.assertEqual(lines, ['| a | 1.000 | - |'])

    def test_sweep_stands_beside_the_paper_and_is_drawn(self):
        rows, lines = printed(
            segmentation_benchmark.m_sweep, FakeBench(self), self.folder, values=(0.2, 0.5)
        )
        self.assertEqual(list(rows), [0.2, 0.5])
        self.assertAlmostEqual(rows[0.2]['sa'], 0.9)
        table = [line for line in lines if line.startswith('| ')]
        self.assertEqual(table[1], '| SA [%] | 90.0 | 75.0 |')
        self.assertRegex(table[2], r"^\| SA \[%\], the paper's .* \| 91\.7 \| 96\.2 \|$")
        self.assertTrue(all(line.count('|') == 4 for line in table))
        self.assertGreater(os.path.getsize(self.path('m_sweep.png')), 10000)

    def test_rivals_are_scored_alike_and_timed_against_ours(self):
        rows, lines = printed(
            segmentation_benchmark.rivals, FakeBench(self), self.folder, stages=('ripe',)
        )
        ours, grown, clustered = rows.values()
        self.assertEqual((ours['segmentation_s'], ours['whole_s'], ours['time_ratio']), (2, 3, 1))
        self.assertEqual((grown['segmentation_s'], grown['whole_s']), (1.0, 2.5))
        self.assertEqual(grown['time_ratio'], 0.5)
        self.assertEqual((ours['stem_f1'], clustered['stem_f1']), (1.0, 1.0))
        self.assertTrue(any("the paper's" in line and '15.2' in line for line in lines))
        self.assertIn('neighbours 30, max_tilt_deg 15', lines[-1])

    def test_scaling_is_against_the_small_field(self):
        rows, lines = printed(segmentation_benchmark.scaling, FakeBench(self), self.folder)
        self.assertEqual([row['truth_plants'] for row in rows.values()], [20, 160])
        self.assertEqual(rows['8 x']['time_ratio'], 2.0)
        self.assertTrue(any('goal' in line for line in lines))

    def test_seconds_of_a_busy_machine_are_marked(self):
        for load, said in ((0.5, []), (64.0 + (os.cpu_count() or 1), ['BUSY'])):
            with mock.patch('os.getloadavg', return_value=(load, load, load)):
                _, lines = printed(segmentation_benchmark.note_load)
            self.assertEqual([line[:4] for line in lines if line], said)

    def test_missing_real_clouds_are_said_aloud(self):
        with mock.patch.dict(os.environ, FIELD_PHENOTYPING_DATA=self.path('nowhere')):
            rows, lines = printed(segmentation_benchmark.real, FakeBench(self), self.folder)
        self.assertEqual(rows, {})
        self.assertRegex(lines[-1], '^SKIPPED real: .*nowhere')

    def test_a_program_that_fails_is_one_clear_error(self):
        with benchmarks.Bench() as bench:
            for program, words in (('/bin/false', 'failed'), ('/no/such', 'No such file')):
                with mock.patch.dict(os.environ, PHENOTYPE_CLOUD=program):
                    with self.assertRaisesRegex(InputError, words):
                        bench.measure('cloud.pcd')


class RecordedDiagnostics(support.FolderTest):
    """Watch, with programs in place of ROS's own."""

    def setUp(self):
        super().setUp()
        self.bag = self.path('diagnostics.bag')
        self.environment = dict(
            os.environ,
            ROS_MASTER_URI='http://localhost:1',
            PATH=self.folder + os.pathsep + os.environ['PATH'],
            BAG=self.bag,
        )
        self.make_program('roscore', 'trap "exit 0" INT; while :; do sleep 0.05; done')

    def make_program(self, name, *lines):
        with open(self.path(name), 'w') as file:
            file.write('\n'.join(('#!/bin/bash',) + lines) + '\n')
        os.chmod(self.path(name), 0o755)

    def watch(self, patience=20.0):
        # subprocess looks programs up on this process's PATH.
        with mock.patch.dict(os.environ, PATH=self.environment['PATH']):
            with benchmarks.Watch(self.environment, self.bag, patience):
                self.assertTrue(os.path.exists(self.bag + '.active'), 'it has not begun')

    def test_a_recorder_that_begins_and_ends_late_is_waited_for(self):
        self.make_program(
            'rosrun',
            'sleep 0.5; echo all > $BAG.active',
            'trap "sleep 0.5; mv $BAG.active $BAG; exit 0" INT; while :; do sleep 0.05; done',
        )
        self.watch()
        with open(self.bag) as bag:
            self.assertEqual(bag.read(), 'all\n')

    def test_one_that_does_not_is_named_with_what_it_said(self):
        never = 'trap "" INT; while :; do sleep 0.05; done'
        for lines, words in (
            (('echo no such master; exit 7',), '(?s)ended with 7:.*no such master'),
            ((never,), 'has not begun within 1 s'),
            (('touch $BAG.active', never), 'has not ended within 1 s'),
            (('touch $BAG.active; trap "exit 0" INT', 'while :; do sleep 0.05; done'), 'no bag'),
        ):
            self.make_program('rosrun', *lines)
            with self.assertRaisesRegex(InputError, words):
                self.watch(patience=1.0)
            if os.path.exists(self.bag + '.active'):
                os.remove(self.bag + '.active')


class StemWithoutEarsAndTassel(unittest.TestCase):
    """A leaning stem with two leaves, an ear at its side, and a tassel above the upper leaf."""

    def setUp(self):
        random = np.random.RandomState(3)
        height = random.uniform(0.0, 2.0, 4000)
        angle = random.uniform(0.0, 2.0 * np.pi, 4000)
        stem = np.column_stack([0.012 * np.cos(angle), 0.012 * np.sin(angle), height])
        ear = [0.06, 0.0, 0.8] + random.normal(0.0, 1.0, (3000, 3)) * [0.01, 0.01, 0.06]
        tassel = [0.0, 0.0, 1.9] + random.normal(0.0, 1.0, (3000, 3)) * [0.08, 0.08, 0.08]
        along = random.uniform(0.012, 0.5, 2000)
        leaves = np.column_stack(
            [
                np.where(np.arange(2000) % 2, along, -along),
                random.uniform(-0.02, 0.02, 2000),
                np.where(np.arange(2000) % 2, 1.4, 0.6) + 0.5 * along,
            ]
        )
        self.positions = np.concatenate([stem, ear, tassel, leaves])
        self.positions[:, 0] += 0.1 * self.positions[:, 2]
        self.part = np.repeat([STEM, OTHER_ORGAN], [10000, 2000])
        self.below = height < 1.38
        self.above = height > 1.5

    def test_the_bare_stem_is_left(self):
        given = self.part.copy()
        part = stem_truth.without_ears_and_tassel(self.positions, self.part)
        np.testing.assert_array_equal(self.part, given)
        self.assertTrue(np.all(part[:4000][self.below] == STEM))
        self.assertTrue(np.all(part[:4000][self.above] == NO_PART))
        self.assertGreater(np.mean(part[4000:7000] == NO_PART), 0.95)  # the ear
        self.assertGreater(np.mean(part[7000:10000] == NO_PART), 0.99)  # the tassel
        self.assertTrue(np.all(part[10000:] == OTHER_ORGAN))

    def test_without_leaves_or_stem(self):
        stem = np.arange(4000)
        part = stem_truth.without_ears_and_tassel(self.positions[stem], self.part[stem])
        self.assertTrue(np.all(part == STEM))
        leaves = np.arange(10000, 12000)
        part = stem_truth.without_ears_and_tassel(self.positions[leaves], self.part[leaves])
        self.assertTrue(np.all(part == OTHER_ORGAN))


if __name__ == '__main__':
    unittest.main()
