"""phenotype_cloud from the outside: its files, its options, and what it says to bad input."""

import json
import os
import re
import unittest

import numpy as np

from program_support import (
    PLANTS,
    PLANT_HEIGHT,
    ROOT,
    STEM_DIAMETER,
    ProgramTest,
    as_cloud,
    content,
    labels_of,
    read_pcd,
    read_table,
    small_field,
    write_pcd,
)

COLUMNS = (
    'plant_id,x,y,z,height,height_stddev,stem_diameter,stem_diameter_stddev,'
    'stem_diameter_minor,diameter_height,lean,arc_coverage,stem_points,plant_points,quality'
).split(',')


GROWTH_COLUMNS = (
    'plant_id,x,y,z,quality,iterations,r1,M,alpha,beta,regions,branchings,merged_regions,'
    'stem_points'
).split(',')
REGION_COLUMNS = (
    'plant_id,region,start_x,start_y,start_z,end_x,end_y,end_z,M,branching,merged,points'
).split(',')


class FieldTest(ProgramTest):
    def setUp(self):
        super().setUp()
        self.positions = small_field()
        self.field = self.path('field.pcd')
        write_pcd(self.field, as_cloud(self.positions))

    def plants_of(self, folder):
        """Rows of plants.csv, matched with PLANTS."""
        rows, _ = read_table(os.path.join(folder, 'plants.csv'))
        self.assertEqual(len(rows), len(PLANTS))
        bases = np.array([[float(row['x']), float(row['y'])] for row in rows])
        order = [int(np.argmin(np.linalg.norm(bases - base, axis=1))) for base in PLANTS]
        self.assertEqual(sorted(order), list(range(len(PLANTS))))
        return [rows[k] for k in order]


class Output(FieldTest):
    def test_plants_are_measured(self):
        out = self.path('deep', 'er', 'run')  # made where missing
        said = self.assert_done(self.measure(self.field, '--output', out))
        self.assertIn('3 plants', said)
        for row, base in zip(self.plants_of(out), PLANTS):
            self.assertLess(np.hypot(float(row['x']) - base[0], float(row['y']) - base[1]), 0.02)
            self.assertAlmostEqual(float(row['z']), 0.05 * base[0], delta=0.01)
            self.assertAlmostEqual(float(row['height']), PLANT_HEIGHT, delta=0.04)
            self.assertAlmostEqual(float(row['stem_diameter']), STEM_DIAMETER, delta=0.002)
            self.assertGreater(float(row['height_stddev']), 0.0)
            self.assertGreater(float(row['stem_diameter_stddev']), 0.0)
            self.assertGreater(int(row['stem_points']), 1500)
            self.assertGreater(int(row['plant_points']), int(row['stem_points']))

    def test_table_has_the_columns_promised(self):
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out))
        rows, header = read_table(os.path.join(out, 'plants.csv'))
        self.assertEqual(header[: len(COLUMNS)], COLUMNS)
        for row in rows:
            self.assertEqual(len(row), len(header))
            for name, text in row.items():
                if name not in ('quality', 'completion'):
                    float(text)  # a number or nan, never empty
        self.assertEqual(len({row['plant_id'] for row in rows}), len(rows))

    def test_labels_hold_every_input_point_in_order(self):
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out))
        labels = labels_of(out)
        self.assertEqual(labels.dtype.names, ('x', 'y', 'z', 'plant_id', 'part'))
        self.assertEqual(labels.dtype['plant_id'], np.dtype('i4'))
        self.assertEqual(labels.dtype['part'], np.dtype('u1'))
        given = as_cloud(self.positions)
        for axis in 'xyz':
            np.testing.assert_allclose(labels[axis], given[axis], rtol=0, atol=1e-6)
        self.assertEqual(set(np.unique(labels['part'])), {0, 1, 2})
        self.assertTrue(np.array_equal(labels['plant_id'] < 0, labels['part'] == 0))
        rows, _ = read_table(os.path.join(out, 'plants.csv'))
        ids = {int(row['plant_id']) for row in rows}
        self.assertEqual(set(labels['plant_id'][labels['plant_id'] >= 0]), ids)
        soil = labels[:9000]
        self.assertLess(np.mean(soil['plant_id'] >= 0), 0.01)
        self.assertGreater(np.mean(labels[9000:]['plant_id'] >= 0), 0.95)

    def test_points_that_are_not_finite_keep_their_place(self):
        positions = np.repeat(self.positions, 2, axis=0)
        positions[1::2] = [np.nan, np.inf, -np.inf]
        write_pcd(self.field, as_cloud(positions))
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out))
        self.plants_of(out)
        labels = labels_of(out)
        self.assertEqual(len(labels), len(positions))
        self.assertTrue(np.all(np.isnan(labels['x'][1::2])))
        self.assertTrue(np.all(np.isposinf(labels['y'][1::2])))
        self.assertTrue(np.all(labels['plant_id'][1::2] == -1))
        self.assertTrue(np.all(labels['part'][1::2] == 0))
        np.testing.assert_allclose(labels['x'][::2], positions[::2, 0], rtol=0, atol=1e-6)

    def test_other_files(self):
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out))
        with open(os.path.join(out, 'timing.json')) as file:
            timing = json.load(file)
        self.assertEqual(
            list(timing), ['preprocessing', 'segmentation', 'completion', 'measurement']
        )
        for stage in timing.values():
            self.assertGreaterEqual(stage['seconds'], 0.0)
            self.assertGreaterEqual(stage['points'], 0)
            self.assertTrue('why_cpu' in stage if stage['device'] == 'cpu' else stage['gpu_steps'])
        with open(os.path.join(out, 'plants.geojson')) as file:
            features = json.load(file)['features']
        self.assertEqual(len(features), len(PLANTS))
        rows, _ = read_table(os.path.join(out, 'rows.csv'))
        self.assertEqual(sum(int(row['plants']) for row in rows), len(PLANTS))
        layers, _ = read_table(os.path.join(out, 'canopy.csv'))
        covers = [float(layer['cover']) for layer in layers]
        self.assertEqual(covers[0], 1.0)
        self.assertEqual(covers, sorted(covers, reverse=True))
        self.assertAlmostEqual(float(layers[-1]['height']), PLANT_HEIGHT, delta=0.15)
        completed = read_pcd(os.path.join(out, 'completed.pcd'))
        self.assertEqual(
            completed.dtype.names,
            ('x', 'y', 'z', 'rgb', 'plant_id', 'synthetic', 'stddev'),
        )
        rows, _ = read_table(os.path.join(out, 'plants.csv'))
        for row in rows:
            of_plant = completed[completed['plant_id'] == int(row['plant_id'])]
            measured = of_plant[of_plant['synthetic'] == 0]
            self.assertEqual(len(measured), int(row['stem_points']))
            self.assertEqual(len(of_plant) - len(measured), int(row['synthetic_points']))
            filled = of_plant[of_plant['synthetic'] == 1]
            self.assertTrue(np.all((filled['stddev'] > 0.0) & (filled['stddev'] < 0.05)))
            self.assertTrue(np.all(np.isnan(measured['stddev'])))
            for flag in row['completion'].split('|'):
                self.assertIn(
                    flag,
                    ('ok', 'too_few_points', 'no_surface', 'open_gap', 'uncertain', 'seen_empty'),
                )

    def test_debug_says_how_every_stem_was_grown(self):
        shift = np.array([500000.0, 4500000.0, 90.0])
        cloud = as_cloud(self.positions.astype('f4').astype('f8') + shift, 'f8')
        write_pcd(self.field, cloud)
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out, '--debug'))
        plants, _ = read_table(os.path.join(out, 'plants.csv'))
        growth, header = read_table(os.path.join(out, 'growth.csv'))
        self.assertEqual(header, GROWTH_COLUMNS)
        regions, header = read_table(os.path.join(out, 'growth_regions.csv'))
        self.assertEqual(header, REGION_COLUMNS)
        self.assertEqual(
            [row['plant_id'] for row in growth], [row['plant_id'] for row in plants]
        )
        for plant, row in zip(plants, growth):
            for name in ('x', 'y', 'z', 'stem_points'):
                self.assertEqual(row[name], plant[name])
            self.assertEqual(row['quality'], plant['segmentation_quality'])
            self.assertGreaterEqual(int(row['iterations']), 1)
            self.assertAlmostEqual(float(row['r1']), 0.04, delta=0.04)
            own = [region for region in regions if region['plant_id'] == row['plant_id']]
            self.assertEqual([int(region['region']) for region in own], list(range(len(own))))
            self.assertEqual(int(row['regions']), len(own))
            self.assertGreater(len(own), 1)
            for name, total in (('branching', 'branchings'), ('merged', 'merged_regions')):
                self.assertEqual(sum(int(region[name]) for region in own), int(row[total]))
            base = np.array([float(row[axis]) for axis in 'xyz'])
            for region in own:
                start, end = (
                    np.array([float(region[end + '_' + axis]) for axis in 'xyz'])
                    for end in ('start', 'end')
                )
                self.assertLess(np.linalg.norm((start - base)[:2]), 0.03)
                self.assertGreater(end[2], start[2])
                self.assertLess(end[2] - base[2], PLANT_HEIGHT + 0.05)
                self.assertGreater(float(region['M']), 0.0)
                self.assertLess(float(region['M']), 1.0)

    def test_debug_files_of_an_earlier_run_are_not_left(self):
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out, '--debug'))
        self.assertTrue(os.path.exists(os.path.join(out, 'growth.csv')))
        self.assert_done(self.measure(self.field, '-o', out))
        self.assertEqual([name for name in os.listdir(out) if 'growth' in name], [])

    def test_same_bytes_on_one_thread_and_two(self):
        for threads in (1, 2):
            out = self.path(str(threads))
            self.assert_done(
                self.measure(self.field, '-o', out, '--debug', '--threads', threads)
            )
        names = sorted(os.listdir(self.path('1')))
        self.assertIn('growth_regions.csv', names)
        self.assertEqual(names, sorted(os.listdir(self.path('2'))))
        for name in names:
            if name != 'timing.json':
                self.assertEqual(
                    content(self.path('1', name)), content(self.path('2', name)), name
                )

    def test_a_second_run_replaces_the_first(self):
        out = self.path('run')
        self.assert_done(self.measure(self.field, '-o', out))
        bare = self.path('bare.pcd')
        write_pcd(bare, as_cloud(self.positions[:9000]))
        self.assert_done(self.measure(bare, '-o', out))
        rows, header = read_table(os.path.join(out, 'plants.csv'))
        self.assertEqual(rows, [])
        self.assertEqual(header[: len(COLUMNS)], COLUMNS)
        labels = labels_of(out)
        self.assertEqual(len(labels), 9000)
        self.assertTrue(np.all(labels['plant_id'] == -1))
        self.assertEqual(len(read_pcd(os.path.join(out, 'completed.pcd'))), 0)


class Input(FieldTest):
    def reference(self):
        out = self.path('reference')
        self.assert_done(self.measure(self.field, '-o', out))
        return self.plants_of(out)

    def assert_same_plants(self, cloud_path, expected, shift=(0.0, 0.0, 0.0), delta=1e-6):
        out = self.path('other')
        self.assert_done(self.measure(cloud_path, '-o', out))
        rows, _ = read_table(os.path.join(out, 'plants.csv'))
        self.assertEqual(len(rows), len(expected))
        for row, other in zip(
            sorted(rows, key=lambda r: float(r['x'])),
            sorted(expected, key=lambda r: float(r['x'])),
        ):
            for k, axis in enumerate('xyz'):
                self.assertAlmostEqual(
                    float(row[axis]) - shift[k], float(other[axis]), delta=delta
                )
            self.assertAlmostEqual(float(row['height']), float(other['height']), delta=delta)
            self.assertAlmostEqual(
                float(row['stem_diameter']), float(other['stem_diameter']), delta=delta
            )
        return out

    def test_ascii_and_ply(self):
        expected = self.reference()
        ascii_path = self.path('field_ascii.PCD')
        write_pcd(ascii_path, as_cloud(self.positions), encoding='ascii')
        self.assert_same_plants(ascii_path, expected)
        ply = self.path('field.ply')
        with open(ply, 'w') as file:
            file.write('ply\nformat ascii 1.0\nelement vertex {}\n'.format(len(self.positions)))
            file.write('property float x\nproperty float y\nproperty float z\nend_header\n')
            for point in self.positions.astype('f4'):
                file.write('{:.9g} {:.9g} {:.9g}\n'.format(*point))
        self.assert_same_plants(ply, expected)

    def test_other_fields_and_layouts(self):
        expected = self.reference()
        count = len(self.positions)
        # A label from elsewhere must not be taken for ours.
        part = np.full(count, 1, 'u1')
        intensity = np.linspace(0.0, 1.0, count).astype('f4')
        rgb = np.full(count, 0x00A020, 'u4').view('f4')
        path = self.path('more.pcd')
        write_pcd(path, as_cloud(self.positions, rgb=rgb, part=part, intensity=intensity))
        out = self.assert_same_plants(path, expected)
        self.assertEqual(set(np.unique(labels_of(out)['part'])), {0, 1, 2})
        # An organised cloud.
        organised = self.path('organised.pcd')
        even = self.positions[: count // 2 * 2]
        write_pcd(organised, as_cloud(even))
        text = content(organised)
        text = text.replace(
            'WIDTH {}\nHEIGHT 1\n'.format(len(even)).encode(),
            'WIDTH {}\nHEIGHT 2\n'.format(len(even) // 2).encode(),
        )
        with open(organised, 'wb') as file:
            file.write(text)
        out = self.path('organised')
        self.assert_done(self.measure(organised, '-o', out))
        self.plants_of(out)
        self.assertEqual(len(labels_of(out)), len(even))

    def test_utm_in_double_precision(self):
        expected = self.reference()
        shift = np.array([500000.0, 4500000.0, 90.0])
        positions = self.positions.astype('f4').astype('f8') + shift
        path = self.path('utm.pcd')
        write_pcd(path, as_cloud(positions, 'f8'))
        out = self.assert_same_plants(path, expected, shift, delta=0.002)
        labels = labels_of(out)
        self.assertEqual(labels.dtype['x'], np.dtype('f8'))
        for k, axis in enumerate('xyz'):
            np.testing.assert_array_equal(labels[axis], positions[:, k])

    def test_utm_with_a_stray_first_point_at_zero(self):
        # Scanners write 0 0 0 where nothing came back.
        expected = self.reference()
        shift = np.array([500000.0, 4500000.0, 90.0])
        positions = np.vstack([[0.0, 0.0, 0.0], self.positions.astype('f4').astype('f8') + shift])
        path = self.path('utm.pcd')
        write_pcd(path, as_cloud(positions, 'f8'))
        self.assert_same_plants(path, expected, shift, delta=0.005)

    def test_one_point(self):
        path = self.path('one.pcd')
        write_pcd(path, as_cloud(self.positions[:1]))
        out = self.path('run')
        self.assertIn('0 plants', self.assert_done(self.measure(path, '-o', out)))
        self.assertEqual(len(labels_of(out)), 1)


class BadInput(FieldTest):
    def assert_input_refused(self, path, *fragments):
        out = self.path('refused')
        self.assert_refused(self.measure(path, '-o', out), *fragments)
        self.assertFalse(os.path.exists(os.path.join(out, 'plants.csv')))

    def write(self, name, text):
        path = self.path(name)
        with open(path, 'wb') as file:
            file.write(text)
        return path

    def test_missing_file(self):
        self.assert_input_refused(self.path('nowhere.pcd'), 'nowhere.pcd', 'error')

    def test_folder(self):
        os.mkdir(self.path('folder.pcd'))
        self.assert_input_refused(self.path('folder.pcd'), 'folder.pcd')

    def test_wrong_extension(self):
        self.assert_input_refused(self.write('plants.las', b'LASF'), 'plants.las', '.pcd', '.ply')

    def test_not_a_cloud(self):
        for name in ('text.pcd', 'text.ply'):
            self.assert_input_refused(self.write(name, b'This is no point cloud.\n' * 50), name)
            self.assert_input_refused(self.write(name, os.urandom(4000)), name)
            self.assert_input_refused(self.write(name, b''), name)

    def test_no_x_field(self):
        cloud = np.zeros(10, np.dtype([('range', 'f4'), ('y', 'f4'), ('z', 'f4')]))
        path = self.path('no_x.pcd')
        write_pcd(path, cloud)
        self.assert_input_refused(path, 'no field x', 'range')

    def test_empty(self):
        path = self.path('empty.pcd')
        for encoding in ('ascii', 'binary'):
            write_pcd(path, as_cloud(self.positions[:0]), encoding)
            self.assert_input_refused(path, 'empty.pcd', 'no points')

    def test_all_nan(self):
        path = self.path('nan.pcd')
        write_pcd(path, as_cloud(np.full((50, 3), np.nan)))
        self.assert_input_refused(path, 'nan.pcd', 'NaN')

    def test_cut_off(self):
        whole = content(self.field)
        self.assert_input_refused(self.write('cut.pcd', whole[: len(whole) // 2]), 'cut.pcd')
        self.assert_input_refused(self.write('cut.pcd', whole[:60]), 'cut.pcd')

    def test_ascii_with_words(self):
        path = self.path('words.pcd')
        write_pcd(path, as_cloud(self.positions[:100]), 'ascii')
        text = content(path).replace(b'\n', b'\nnorth ', 15)
        self.assert_input_refused(self.write('words.pcd', text), 'words.pcd')

    def test_header_that_promises_too_much(self):
        text = content(self.field).replace(b'COUNT 1 1 1', b'COUNT 1 1 9999')
        self.assert_input_refused(self.write('header.pcd', text), 'header.pcd')
        text = re.sub(rb'(WIDTH|POINTS) \d+', rb'\1 4000000000', content(self.field))
        self.assert_input_refused(self.write('header.pcd', text), 'header.pcd')


    def test_other_units(self):
        for factor in (1e3, 1e2):  # millimetres, centimetres
            path = self.path('units.pcd')
            write_pcd(path, as_cloud(factor * self.positions))
            self.assert_input_refused(path, 'units.pcd', 'metres', '0.001')

    def warnings_of(self, positions):
        path = self.path('odd.pcd')
        write_pcd(path, as_cloud(positions))
        result = self.measure(path, '-o', self.path('odd'))
        self.assert_done(result)
        return '\n'.join(result[2])

    def test_plants_upside_down(self):
        self.assertIn('z points up', self.warnings_of(self.positions * [1, -1, -1]))

    def test_soil_alone(self):
        soil = self.positions[:9000]
        self.assertIn('no plant found in', self.warnings_of(soil))

    def test_utm_in_single_precision(self):
        shift = np.array([500000.0, 4500000.0, 90.0])
        self.assertIn('FLOAT64', self.warnings_of(self.positions + shift))

    def test_a_good_field_is_not_warned_of(self):
        self.assertEqual(self.warnings_of(self.positions), '')


class BadOutput(FieldTest):
    def test_below_a_file(self):
        self.assert_refused(
            self.measure(self.field, '-o', os.path.join(self.field, 'out')), self.field, 'error'
        )

    def test_a_file_in_the_way(self):
        self.assert_refused(self.measure(self.field, '-o', self.field), self.field)

    def test_a_file_that_cannot_be_written(self):
        names = ('plants.csv', 'plants.geojson', 'rows.csv', 'canopy.csv')
        for name in names + ('labels.pcd', 'completed.pcd', 'timing.json'):
            out = self.path('blocked_' + name)
            os.makedirs(os.path.join(out, name, 'in the way'))
            self.assert_refused(self.measure(self.field, '-o', out), name)
        for name in ('growth.csv', 'growth_regions.csv'):
            out = self.path('blocked_' + name)
            os.makedirs(os.path.join(out, name, 'in the way'))
            self.assert_refused(self.measure(self.field, '-o', out, '--debug'), name)
            self.assert_refused(self.measure(self.field, '-o', out), name)

    def test_said_before_the_work(self):
        self.assert_refused(self.measure(self.field, '-o', os.path.join(self.field, 'out')))
        self.assertEqual([line for line in self.progress if 'measuring' in line], [])


class Options(FieldTest):
    def test_help(self):
        said = self.assert_done(self.measure('--help'))
        for word in ('--output', '--config', '--set', '--device', '--threads', '--debug'):
            self.assertIn(word, said)
        for word in ('.pcd', '.ply', 'growth.csv', 'growth_regions.csv'):
            self.assertIn(word, said)
        self.assertRegex(said, 'metres')

    def test_missing_arguments(self):
        self.assert_refused(self.measure())
        self.assert_refused(self.measure(self.field), '--output')
        self.assert_refused(self.measure('-o', self.path('run')))
        self.assert_refused(self.measure(self.field, '-o', self.path('run'), '--colour'))

    def test_bad_choices(self):
        for option, value in (('--device', 'tpu'), ('--threads', '-1'), ('--threads', 'many')):
            self.assert_refused(
                self.measure(self.field, '-o', self.path('run'), option, value), option
            )

    def test_cuda_is_there_or_it_is_said_why_not(self):
        done = self.measure(self.field, '-o', self.path('run'), '--device', 'cuda')
        if done[0] != 0:
            self.assert_refused(done, 'no GPU')

    def test_cpu_is_the_cpu_and_auto_says_what_it_is(self):
        for wish in ('cpu', 'auto'):
            out = self.path('run_' + wish)
            self.assert_done(self.measure(self.field, '-o', out, '--device', wish))
            with open(os.path.join(out, 'timing.json')) as file:
                stage = json.load(file)['segmentation']
            if wish == 'cpu':
                self.assertEqual(stage['device'], 'cpu')
                self.assertEqual(stage['why_cpu'], 'the CPU was asked for')
            elif stage['device'] == 'cpu':
                self.assertIn('no GPU', stage['why_cpu'])

    def test_list_of_parameters_can_be_set_back(self):
        said = self.assert_done(self.measure('--list-parameters'))
        found = re.findall(r'^(\w+/\w+) = (\S+)(?: (\S+))?  \[(\S+) \.\.\. (\S+)\]$', said, re.M)
        names = [line[0] for line in found]
        for name in ('M', 'r1', 'alpha', 'beta'):
            self.assertIn('segmentation/' + name, names)
        self.assertGreater(len(names), 40)
        self.assertEqual(len(set(names)), len(names))
        units = {line[0]: line[2] for line in found}
        self.assertEqual(units['segmentation/r1'], 'm')
        self.assertEqual(units['preprocessing/ground_max_tilt'], 'deg')
        assignments = ['--set={}={}'.format(line[0], line[1]) for line in found]
        self.assert_done(self.measure(self.field, '-o', self.path('plain')))
        self.assert_done(self.measure(self.field, '-o', self.path('set'), *assignments))
        self.assertEqual(
            content(self.path('plain', 'plants.csv')), content(self.path('set', 'plants.csv'))
        )

    def test_shipped_configurations(self):
        folder = os.path.join(ROOT, 'config')
        self.assertGreaterEqual(
            set(os.listdir(folder)), {'maize.yaml', 'seedling.yaml', 'sorghum.yaml'}
        )
        for name in sorted(os.listdir(folder)):
            with self.subTest(name):
                out = self.path('run')
                config = os.path.join(folder, name)
                self.assert_done(self.measure(self.field, '-o', out, '--config', config))
                self.plants_of(out)

    def test_set_and_config_have_effect(self):
        def stem_points(*arguments):
            out = self.path('run')
            self.assert_done(self.measure(self.field, '-o', out, *arguments))
            rows, _ = read_table(os.path.join(out, 'plants.csv'))
            return sum(int(row['stem_points']) for row in rows)

        config = self.path('strict.yaml')
        with open(config, 'w') as file:
            file.write('segmentation:\n  M: 0.9\n')
        default = stem_points()
        strict = stem_points('--config', config)
        self.assertLess(strict, default)
        self.assertEqual(stem_points('--set', 'segmentation/M=0.9'), strict)
        # The command line has the last word.
        self.assertEqual(
            stem_points('--config', config, '--set', 'segmentation/M=0.5'), default
        )

    def test_crop_box(self):
        out = self.path('run')
        said = self.assert_done(
            self.measure(self.field, '-o', out, '--set', 'preprocessing/max_x=1.0')
        )
        self.assertIn('1 plants', said)

    def test_limits_may_be_set_in_any_order(self):
        self.assert_done(
            self.measure(
                self.field,
                '-o',
                self.path('run'),
                '--set',
                'preprocessing/min_range=50',
                '--set',
                'preprocessing/max_range=80',
            )
        )

    def test_bad_assignments(self):
        for text, fragments in (
            ('segmentation/N=0.5', ("'segmentation/N'", "'segmentation/M' (0.01 ... 1)")),
            ('segmentation/max_growth_step=5', ("'segmentation/max_growth_steps'",)),
            ('segmentation/block_siz=5', ("'preprocessing/block_size' (0.5 ... 100 m)",)),
            ('segmentatoin/M=0.5', ("'segmentation'",)),
            ('M=0.5', ('stage/parameter=value',)),
            ('segmentation/M', ('stage/parameter=value',)),
            ('segmentation/M=', ('segmentation/M',)),
            ('segmentation/M=high', ('segmentation/M', 'high', 'a number (0.01 ... 1)')),
            ('segmentation/M=0.5 0.6', ('segmentation/M',)),
            ('segmentation/max_growth_steps=1.5', ('max_growth_steps', '1.5')),
            ('segmentation/M=1.5', ('segmentation/M', '1.5', '0.01 ... 1')),
            ('segmentation/M=nan', ('segmentation/M',)),
            ('segmentation/M=-.inf', ('segmentation/M',)),
            ('completion/enabled=perhaps', ('completion/enabled', 'perhaps')),
            ('measurement/mode=guess', ('measurement/mode', 'guess', 'robust', 'paper')),
            ('measurement/mode=papr', ("did you mean 'paper'",)),
            ('preprocessing/min_range=40', ('min_range', '30')),
            ('preprocessing/voxel_size=0.03', ('voxel_size', 'segmentation/max_stem_radius')),
        ):
            with self.subTest(text):
                self.assert_refused(
                    self.measure(self.field, '-o', self.path('run'), '--set', text), *fragments
                )
        self.assertFalse(os.path.exists(self.path('run')))

    def test_bad_configurations(self):
        config = self.path('bad.yaml')
        for text, fragments in (
            ('segmentation:\n  MM: 0.5\n', ("'segmentation/MM'", "'segmentation/M' (0.01 ... 1)")),
            ('segmentation: {M: 0.5}\nmeasurement: {noise: 0}\nsegmentation: {M: 0.6}\n',
             ('segmentation/M is given twice',)),
            ('segmentations:\n  M: 0.5\n', ("'segmentation'",)),
            ('segmentation:\n  M: 2\n', ('segmentation/M', '2')),
            ('segmentation:\n  M: [1, 2]\n', ('segmentation/M',)),
            ('segmentation:\n  M:\n', ('segmentation/M',)),
            ('segmentation: 3\n', ('stage: {parameter: value}',)),
            ('- M\n- r1\n', ('stage: {parameter: value}',)),
            ('just words\n', ('stage: {parameter: value}',)),
            ('segmentation: {M: 0.5\n', ('YAML',)),
            ('? [a, b]\n: {M: 0.5}\n', ()),
        ):
            with self.subTest(text):
                with open(config, 'w') as file:
                    file.write(text)
                self.assert_refused(
                    self.measure(self.field, '-o', self.path('run'), '--config', config),
                    'bad.yaml',
                    *fragments
                )
        missing = self.path('missing.yaml')
        self.assert_refused(
            self.measure(self.field, '-o', self.path('run'), '--config', missing), missing
        )
        # An empty file sets nothing.
        with open(config, 'w') as file:
            file.write('# nothing here\n')
        self.assert_done(self.measure(self.field, '-o', self.path('run'), '--config', config))


if __name__ == '__main__':
    unittest.main()
