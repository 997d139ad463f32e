"""Runs the program named by the environment variable CLOUD_TO_BAG."""

import os
import struct
import subprocess
import unittest

import numpy as np

import support

try:
    import rosbag
except ImportError:
    rosbag = None

PROGRAM = os.environ.get('CLOUD_TO_BAG', '')
FLOAT32, FLOAT64 = 7, 8  # sensor_msgs/PointField
NUMPY_TYPE = {FLOAT32: 'f4', FLOAT64: 'f8'}
COLORED = np.dtype(
    [('part', 'u1'), ('x', 'f4'), ('y', 'f4'), ('z', 'f4'), ('rgb', 'u4'), ('intensity', 'u2')]
)


def colored(points=10):
    random = np.random.RandomState(6)
    cloud = np.zeros(points, COLORED)
    for axis in 'xyz':
        cloud[axis] = random.randn(points)
    cloud['rgb'] = random.randint(0, 2**24, points)
    cloud['intensity'] = random.randint(0, 2**16, points)
    cloud['part'] = 1
    return cloud


def points_of(message):
    fields = {
        'names': [field.name for field in message.fields],
        'formats': [NUMPY_TYPE[field.datatype] for field in message.fields],
        'offsets': [field.offset for field in message.fields],
        'itemsize': message.point_step,
    }
    return np.frombuffer(message.data, np.dtype(fields))


@unittest.skipUnless(PROGRAM, 'set CLOUD_TO_BAG to the program to test')
@unittest.skipUnless(rosbag, 'needs python3-rosbag')
class CloudToBag(support.FolderTest):
    def run_on(self, path, *arguments):
        if '--output' not in arguments:
            arguments += ('--output', self.path('out.bag'))
        done = subprocess.run(
            [PROGRAM, path] + list(arguments),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
        )
        return done.returncode, done.stdout, done.stderr

    def convert(self, cloud, *arguments, encoding='binary'):
        support.write_pcd(self.path('in.pcd'), cloud, encoding)
        status, out, err = self.run_on(self.path('in.pcd'), *arguments)
        self.assertEqual(status, 0, err)
        return self.messages(), out, err

    def messages(self):
        with rosbag.Bag(self.path('out.bag')) as bag:
            return [(topic, message, time) for topic, message, time in bag.read_messages()]

    def test_one_latched_message_with_the_fields_of_a_sensor(self):
        for encoding in ('binary', 'ascii'):
            ((topic, message, time),), out, _ = self.convert(colored(), encoding=encoding)
            self.assertEqual((topic, message.header.frame_id), ('/points', 'map'))
            self.assertEqual((time.to_sec(), message.header.stamp.to_sec()), (1.7e9, 1.7e9))
            self.assertEqual(
                [field.name for field in message.fields], ['x', 'y', 'z', 'rgb', 'intensity']
            )
            self.assertEqual((message.height, message.width, message.is_dense), (1, 10, True))
            points, cloud = points_of(message), colored()
            for name in ('x', 'y', 'z', 'intensity'):
                np.testing.assert_array_equal(points[name], cloud[name].astype('f4'))
            np.testing.assert_array_equal(points['rgb'].copy().view('u4'), cloud['rgb'])
            self.assertIn('left out, as no sensor gives them: part', out)
        with rosbag.Bag(self.path('out.bag')) as bag:
            self.assertEqual([c.header['latching'] for c in bag._get_connections()], [b'1'])

    def test_chunks_hold_every_point_once_in_order(self):
        messages, _, _ = self.convert(
            colored(103),
            '--chunks',
            '4',
            '--rate',
            '2',
            '--stamp',
            '50',
            '--topic',
            '/scan/points',
            '--frame',
            'odom',
        )
        self.assertEqual([time.to_sec() for _, _, time in messages], [50.0, 50.5, 51.0, 51.5])
        self.assertEqual(
            {(topic, message.header.frame_id) for topic, message, _ in messages},
            {('/scan/points', 'odom')},
        )
        self.assertLessEqual(
            max(m.width for _, m, _ in messages) - min(m.width for _, m, _ in messages), 1
        )
        whole = np.concatenate([points_of(message)['x'] for _, message, _ in messages])
        np.testing.assert_array_equal(whole, colored(103)['x'])
        with rosbag.Bag(self.path('out.bag')) as bag:
            self.assertEqual([c.header['latching'] for c in bag._get_connections()], [b'0'])

    def test_doubles_far_from_zero_stay_doubles(self):
        cloud = np.zeros(5, np.dtype([('x', 'f8'), ('y', 'f8'), ('z', 'f8')]))
        cloud['x'], cloud['y'] = 512345.678 + np.arange(5) * 1e-3, 5412345.6789
        for encoding in ('binary', 'ascii'):
            ((_, message, _),), out, _ = self.convert(cloud, encoding=encoding)
            self.assertEqual(message.fields[0].datatype, FLOAT64)
            np.testing.assert_array_equal(points_of(message)['x'], cloud['x'])
            np.testing.assert_array_equal(points_of(message)['y'], cloud['y'])
            self.assertIn('written as FLOAT64', out)

    def test_doubles_near_zero_become_floats(self):
        cloud = np.zeros(5, np.dtype([('x', 'f8'), ('y', 'f8'), ('z', 'f8')]))
        cloud['x'] = np.arange(5) * 0.3
        ((_, message, _),), _, _ = self.convert(cloud)
        self.assertEqual(message.fields[0].datatype, FLOAT32)
        np.testing.assert_array_equal(points_of(message)['x'], cloud['x'].astype('f4'))

    def test_floats_far_from_zero_are_warned_of(self):
        cloud = colored()
        cloud['y'] += 5.4e6
        self.assertIn('32-bit coordinates', self.convert(cloud)[2])

    def test_invalid_points_are_kept_and_told(self):
        cloud = colored()
        cloud['z'][3] = np.nan
        ((_, message, _),), out, _ = self.convert(cloud)
        self.assertEqual((message.width, message.is_dense), (10, False))
        self.assertTrue(np.isnan(points_of(message)['z'][3]))
        self.assertIn('1 points are not finite', out)

    def write_ply(self, header, body):
        with open(self.path('in.ply'), 'wb') as file:
            file.write('\n'.join(['ply'] + header + ['end_header', '']).encode() + body)
        status, _, err = self.run_on(self.path('in.ply'))
        self.assertEqual(status, 0, err)
        ((_, message, _),) = self.messages()
        return message, points_of(message)

    def test_ply(self):
        message, points = self.write_ply(
            [
                'format ascii 1.0',
                'element vertex 2',
                'property float x',
                'property float y',
                'property float z',
                'property uchar red',
                'property uchar green',
                'property uchar blue',
            ],
            b'1 2 3 255 128 1\n4 5 6 0 0 7\n',
        )
        np.testing.assert_array_equal(points['y'], [2, 5])
        np.testing.assert_array_equal(points['rgb'].copy().view('u4') & 0xFFFFFF, [0xFF8001, 7])

    def test_ply_with_doubles(self):
        values = [512345.6781, 5412345.6789, 90.5]
        message, points = self.write_ply(
            [
                'format binary_little_endian 1.0',
                'element vertex 1',
                'property double x',
                'property double y',
                'property double z',
            ],
            struct.pack('<3d', *values),
        )
        self.assertEqual(message.fields[0].datatype, FLOAT64)
        self.assertEqual(list(points[0]), values)

    def test_a_large_cloud_is_whole(self):
        cloud = colored(300000)
        ((_, message, _),), _, _ = self.convert(cloud)
        np.testing.assert_array_equal(points_of(message)['z'], cloud['z'])

    def assert_refused(self, words, path, *arguments):
        status, _, err = self.run_on(path, *arguments)
        self.assertNotEqual(status, 0)
        self.assertEqual(err.count('error:'), 1, err)
        self.assertIn(words, err)
        self.assertFalse(os.path.exists(self.path('out.bag')))
        self.assertFalse(os.path.exists(self.path('out.bag.active')))

    def test_bad_clouds_are_one_clear_error(self):
        in_pcd = self.path('in.pcd')
        self.assert_refused('cannot read', self.path('missing.pcd'))
        self.assert_refused('cannot read', self.folder)
        for name, content in (
            ('a.txt', b'1 2 3\n'),
            ('a.pcd', b'hello\n'),
            ('b.pcd', b''),
            ('a.ply', b'hello\n'),
            ('b.ply', b''),
            (
                'c.ply',
                b'ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\n'
                b'property float y\nproperty float z\nend_header\n1 2 3\n',
            ),
        ):
            with open(self.path(name), 'wb') as file:
                file.write(content)
        self.assert_refused('neither .pcd nor .ply', self.path('a.txt'))
        self.assert_refused('no valid PCD header', self.path('a.pcd'))
        self.assert_refused('no valid PCD header', self.path('b.pcd'))
        for name in ('a.ply', 'b.ply', 'c.ply'):
            self.assert_refused('not a valid ply', self.path(name))
        for cloud, words in (
            (colored(0), 'holds no points'),
            (colored()[['y', 'z']], 'no field x'),
        ):
            support.write_pcd(in_pcd, cloud)
            self.assert_refused(words, in_pcd)
        support.write_pcd(in_pcd, colored(), body=colored().tobytes()[:-1])
        self.assert_refused('it was cut off', in_pcd)
        for words, bad in (
            ('line 3 after DATA', b'1 1 two 3 4 5\n'),
            ('not 6 numbers', b'1 2 3\n'),
            ('not a valid pcd', b''),
        ):
            support.write_pcd(in_pcd, colored(), 'ascii', b'1 2 3 4 5 6\n' * 2 + bad)
            self.assert_refused(words, in_pcd)
        support.write_pcd(in_pcd, colored(), 'binary_compressed', b'\xff\xff\0\0\xff\xff\0\0abc')
        self.assert_refused(in_pcd, in_pcd)
        nothing = colored()
        nothing['x'] = np.nan
        support.write_pcd(in_pcd, nothing)
        self.assert_refused('is finite', in_pcd)

    def test_bad_settings_are_one_clear_error(self):
        in_pcd = self.path('in.pcd')
        support.write_pcd(in_pcd, colored())
        for words, arguments in (
            ('not a tf frame', ['--frame', '/map']),
            ('not a tf frame', ['--frame', '']),
            ('not a topic', ['--topic', 'my points']),
            ('--chunks', ['--chunks', '0']),
            ('--chunks', ['--chunks', '11']),
            ('--rate', ['--rate', '0']),
            ('--rate', ['--rate', 'nan']),
            ('--stamp', ['--stamp', '0']),
            ('--stamp', ['--stamp', '5e9']),
            ('Check that its folder', ['--output', self.path('no', 'a.bag')]),
        ):
            self.assert_refused(words, in_pcd, *arguments)


if __name__ == '__main__':
    unittest.main()
