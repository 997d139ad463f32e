import unittest

import numpy as np

import support
from field_phenotyping_tools import pcd
from field_phenotyping_tools.errors import InputError

WIDE = np.dtype(
    [
        ('x', 'f8'),
        ('y', 'f8'),
        ('z', 'f8'),
        ('plant_id', 'i4'),
        ('part', 'u1'),
        ('normal', 'f4', (3,)),
        ('time', 'u4'),
    ]
)


def example(points=50):
    random = np.random.RandomState(3)
    cloud = np.zeros(points, WIDE)
    cloud['x'] = 500000.0 + random.rand(points)
    cloud['y'], cloud['z'] = random.rand(2, points)
    cloud['plant_id'] = random.randint(-1, 1000, points)
    cloud['part'] = random.randint(0, 3, points)
    cloud['normal'] = random.rand(points, 3)
    cloud['time'] = random.randint(0, 2**31, points)
    return cloud


def columns_one_after_the_other(cloud):
    return b''.join(np.ascontiguousarray(cloud[name]).tobytes() for name in cloud.dtype.names)


def literals(data):
    """LZF that copies nothing: runs of at most 32 bytes, each after its length - 1."""
    pieces = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b''.join(bytes([len(piece) - 1]) + piece for piece in pieces)


def sized(compressed, size):
    return np.array([len(compressed), size], '<u4').tobytes() + compressed


class ReadPcd(support.FolderTest):
    def test_binary_keeps_every_field_and_type(self):
        support.write_pcd(self.path('a.pcd'), example())
        read = pcd.read_pcd(self.path('a.pcd'))
        self.assertEqual(read.dtype, WIDE)
        np.testing.assert_array_equal(read, example())

    def test_ascii_keeps_doubles_and_integers(self):
        cloud = example()
        cloud['z'][4] = np.nan
        support.write_pcd(self.path('a.pcd'), cloud, 'ascii')
        read = pcd.read_pcd(self.path('a.pcd'))
        for name in WIDE.names:
            np.testing.assert_array_equal(read[name], cloud[name])

    def test_compressed_literals(self):
        cloud = example()
        data = columns_one_after_the_other(cloud)
        support.write_pcd(
            self.path('a.pcd'), cloud, 'binary_compressed', sized(literals(data), len(data))
        )
        np.testing.assert_array_equal(pcd.read_pcd(self.path('a.pcd')), cloud)

    def test_compressed_copies_that_overlap_what_they_write(self):
        # 1 literal byte, then "3 + 1 back references": 0xE0 means 9 or more, from distance 1.
        cloud = np.zeros(100, np.dtype([('part', 'u1')]))
        cloud['part'] = 7
        body = sized(bytes([0, 7, 0xE0, 99 - 9, 0]), 100)
        support.write_pcd(self.path('a.pcd'), cloud, 'binary_compressed', body)
        np.testing.assert_array_equal(pcd.read_pcd(self.path('a.pcd')), cloud)

    def test_no_points(self):
        for encoding, body in (('binary', b''), ('ascii', b''), ('binary_compressed', b'')):
            support.write_pcd(self.path('a.pcd'), example(0), encoding, body)
            self.assertEqual(len(pcd.read_pcd(self.path('a.pcd'))), 0)

    def test_padding_fields(self):
        cloud = np.zeros(2, np.dtype([('x', 'f4'), ('_', 'u1', (4,)), ('y', 'f4')]))
        cloud['y'] = 1, 2
        support.write_pcd(self.path('a.pcd'), cloud)
        np.testing.assert_array_equal(pcd.read_pcd(self.path('a.pcd'))['y'], [1, 2])

    def test_positions_are_double(self):
        support.write_pcd(self.path('a.pcd'), example())
        positions = pcd.xyz(pcd.read_pcd(self.path('a.pcd')), 'a.pcd')
        self.assertEqual(positions.dtype, np.float64)
        np.testing.assert_array_equal(positions[:, 0], example()['x'])

    def assert_refused(self, words, path):
        with self.assertRaises(InputError) as caught:
            pcd.xyz(pcd.read_pcd(path), path)
        self.assertIn(words, str(caught.exception))

    def test_refuses_what_is_no_cloud(self):
        self.assert_refused('No such file', self.path('missing.pcd'))
        with open(self.path('text.pcd'), 'w') as file:
            file.write('hello\nworld\n')
        self.assert_refused('not a PCD', self.path('text.pcd'))
        support.write_pcd(self.path('no_x.pcd'), example()[['y', 'z']].copy())
        self.assert_refused('no field x', self.path('no_x.pcd'))
        support.write_pcd(self.path('words.pcd'), example(), 'ascii', b'1 two 3\n')
        self.assert_refused('not a number', self.path('words.pcd'))

    def test_refuses_a_file_cut_short(self):
        for encoding, body in (
            ('binary', example().tobytes()[:-1]),
            ('ascii', b'1 2 3\n'),
            ('binary_compressed', sized(b'\0a', 5000)[:-1]),
            ('binary_compressed', b'\1'),
        ):
            support.write_pcd(self.path('cut.pcd'), example(), encoding, body)
            self.assert_refused('ends before', self.path('cut.pcd'))

    def test_refuses_damaged_compression(self):
        size = 50 * WIDE.itemsize
        for compressed in (b'\xe0\x00', b'\x20\x05', b'\x00a'):
            support.write_pcd(
                self.path('bad.pcd'), example(), 'binary_compressed', sized(compressed, size)
            )
            self.assert_refused('damaged', self.path('bad.pcd'))

    def test_refuses_a_broken_header(self):
        support.write_pcd(self.path('a.pcd'), example())
        with open(self.path('a.pcd'), 'rb') as file:
            content = file.read()
        with open(self.path('a.pcd'), 'wb') as file:
            file.write(content.replace(b'SIZE 8', b'SIZE 3'))
        self.assert_refused('broken PCD header', self.path('a.pcd'))


if __name__ == '__main__':
    unittest.main()
