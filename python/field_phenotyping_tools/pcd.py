"""Reads PCD 0.7 point clouds: ascii, binary and binary_compressed, any field type."""

import os
import struct

import numpy as np

from .errors import InputError

_TYPES = {
    ('F', 4): 'f4',
    ('F', 8): 'f8',
    ('I', 1): 'i1',
    ('I', 2): 'i2',
    ('I', 4): 'i4',
    ('I', 8): 'i8',
    ('U', 1): 'u1',
    ('U', 2): 'u2',
    ('U', 4): 'u4',
    ('U', 8): 'u8',
}
_LONGEST_HEADER = 65536


def read_pcd(path):
    """Returns a structured array, one element per point, with the file's field names and types.

    A field with COUNT above 1 becomes a sub-array. Padding fields, all named `_` in the file, get
    their place in the list of fields as a suffix. Raises InputError for a file that is missing, no
    PCD, or shorter than it claims.
    """
    try:
        with open(path, 'rb') as file:
            content = file.read()
    except OSError as error:
        raise InputError('Cannot read {}: {}. Check the path.'.format(path, error.strerror))
    header, body = _split_header(content, path)
    dtype, points = _layout(header, path)
    encoding = header['DATA'][0]
    if encoding == 'ascii':
        return _read_ascii(body, dtype, points, path)
    if encoding == 'binary':
        return _read_binary(body, dtype, points, path)
    if encoding == 'binary_compressed':
        return _read_compressed(body, dtype, points, path)
    raise InputError(
        '{}: unknown encoding "DATA {}". Convert it with pcl_convert_pcd_ascii_binary.'.format(
            path, encoding
        )
    )


def xyz(cloud, path):
    """The positions of a cloud as an (n, 3) float64 array [m]; `path` is for the error message."""
    require_fields(cloud, ('x', 'y', 'z'), path)
    return np.column_stack([cloud[axis].astype(np.float64) for axis in 'xyz'])


def require_fields(cloud, names, path):
    """Raises InputError unless the cloud has all the fields named."""
    missing = [name for name in names if name not in cloud.dtype.names]
    if missing:
        raise InputError(
            '{} has no field {}; it has {}. Is this the right file?'.format(
                path, ', '.join(missing), ', '.join(cloud.dtype.names)
            )
        )


def _split_header(content, path):
    header = {}
    position = 0
    while position < min(len(content), _LONGEST_HEADER):
        end = content.find(b'\n', position)
        if end < 0:
            break
        words = content[position:end].decode('latin-1').split()
        position = end + 1
        if not words or words[0].startswith('#'):
            continue
        header[words[0]] = words[1:]
        if words[0] == 'DATA' and len(words) > 1:
            return header, content[position:]
    raise InputError(
        '{} is not a PCD file: no "DATA" line in its header. '
        'Give a .pcd file.'.format(os.fspath(path))
    )


def _layout(header, path):
    try:
        names = _unique(header.get('FIELDS') or header['COLUMNS'])
        sizes = [int(size) for size in header['SIZE']]
        kinds = header['TYPE']
        counts = [int(count) for count in header.get('COUNT', ['1'] * len(names))]
        points = int(
            header['POINTS'][0]
            if 'POINTS' in header
            else int(header['WIDTH'][0]) * int(header['HEIGHT'][0])
        )
        if not len(names) == len(sizes) == len(kinds) == len(counts):
            raise ValueError('FIELDS, SIZE, TYPE and COUNT differ in length')
        fields = [
            (name, _TYPES[(kind, size)]) if count == 1 else (name, _TYPES[(kind, size)], (count,))
            for name, kind, size, count in zip(names, kinds, sizes, counts)
        ]
    except (KeyError, ValueError, IndexError) as error:
        raise InputError('{}: broken PCD header ({}). Write the file anew.'.format(path, error))
    return np.dtype(fields), points


def _unique(names):
    return ['_{}'.format(i) if name == '_' else name for i, name in enumerate(names)]


def _too_short(path, points):
    return InputError(
        '{} ends before its {} points do: it was cut off while being written or '
        'copied. Write it anew.'.format(path, points)
    )


def _columns(dtype):
    """(name, base type, number of values) of each field."""
    for name in dtype.names:
        base, shape = dtype[name].base, dtype[name].shape
        yield name, base, int(np.prod(shape)) if shape else 1


def _read_ascii(body, dtype, points, path):
    width = sum(count for _, _, count in _columns(dtype))
    try:
        values = np.array(body.split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(
            '{}: not a number among its points ({}). Repair that line.'.format(path, error)
        )
    if values.size < points * width:
        raise _too_short(path, points)
    values = values[: points * width].reshape(points, width)
    cloud = np.empty(points, dtype)
    first = 0
    for name, base, count in _columns(dtype):
        column = values[:, first : first + count]
        cloud[name] = column[:, 0].astype(base) if dtype[name].shape == () else column.astype(base)
        first += count
    return cloud


def _read_binary(body, dtype, points, path):
    if len(body) < points * dtype.itemsize:
        raise _too_short(path, points)
    return np.frombuffer(body, dtype, points)


def _read_compressed(body, dtype, points, path):
    if points == 0:
        return np.empty(0, dtype)
    if len(body) < 8:
        raise _too_short(path, points)
    compressed_size, size = struct.unpack_from('<II', body)
    if len(body) < 8 + compressed_size or size < points * dtype.itemsize:
        raise _too_short(path, points)
    data = _lzf_decompress(body[8 : 8 + compressed_size], size, path)
    cloud = np.empty(points, dtype)
    first = 0
    for name, base, count in _columns(dtype):
        column = np.frombuffer(data, base, points * count, first)
        cloud[name] = column if dtype[name].shape == () else column.reshape(points, count)
        first += points * count * base.itemsize
    return cloud


def _lzf_decompress(data, size, path):
    """LZF as PCL writes it: runs of literals, and copies of what was already written."""
    out = bytearray()
    position, end = 0, len(data)
    try:
        while position < end:
            control = data[position]
            position += 1
            if control < 32:
                out += data[position : position + control + 1]
                position += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[position]
                position += 1
            length += 2
            start = len(out) - ((control & 0x1F) << 8) - data[position] - 1
            position += 1
            if start < 0:
                raise IndexError
            while length > 0:
                piece = out[start : start + length]
                out += piece
                start += len(piece)
                length -= len(piece)
    except IndexError:
        out = b''
    if len(out) != size:
        raise InputError('{}: its compressed data are damaged. Write it anew.'.format(path))
    return bytes(out)
