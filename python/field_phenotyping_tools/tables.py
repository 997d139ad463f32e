"""Reads the CSV tables that the programs of this package write."""

import csv

import numpy as np

from .errors import InputError


def read_table(path, required):
    """Returns {column name: array} for a CSV file with a header row.

    A column in which every cell is a number (or `nan`, or empty, read as NaN) is float64, any other
    an array of strings. A table with a header and no rows has columns of length 0. Raises
    InputError for a missing file, no header, a required column that is missing, or ragged rows.
    """
    try:
        with open(path, newline='') as file:
            rows = [row for row in csv.reader(file) if row]
    except OSError as error:
        raise InputError('Cannot read {}: {}. Check the path.'.format(path, error.strerror))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError('{} is not a CSV table ({}). Give a .csv file.'.format(path, error))
    if not rows:
        raise InputError(
            '{} is empty: not even a header row. The program that wrote it did not '
            'finish; run it again.'.format(path)
        )
    names = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise InputError(
                '{}: row {} has {} cells, the header {}. The file is damaged; write it '
                'anew.'.format(path, number, len(row), len(names))
            )
    table = {name: _column([row[i] for row in rows[1:]]) for i, name in enumerate(names)}
    require_numbers(table, required, path)
    return table


def require_numbers(table, names, path):
    """Raises InputError unless the table has all the columns named, each of numbers."""
    missing = [name for name in names if name not in table]
    if missing:
        raise InputError(
            '{} has no column {}; it has {}. Is this the right file?'.format(
                path, ', '.join(missing), ', '.join(table)
            )
        )
    for name in names:
        if table[name].dtype.kind != 'f':
            raise InputError('{}: column {} must hold numbers.'.format(path, name))


def ids(table, column, path):
    """The column as int64; raises InputError where an id is missing, not whole, or given twice."""
    values = table[column]
    if values.size and not np.all(np.isfinite(values) & (values == np.round(values))):
        raise InputError('{}: column {} must hold whole numbers.'.format(path, column))
    values = values.astype(np.int64)
    unique, counts = np.unique(values, return_counts=True)
    if np.any(counts > 1):
        raise InputError(
            '{}: {} {} is given {} times; every plant must have its own.'.format(
                path, column, unique[counts > 1][0], counts[counts > 1][0]
            )
        )
    return values


def id_list(values):
    """Ids for people: 'ids 1 to 4, 7', or 'none'."""
    values = np.unique(np.asarray(values, np.int64))
    if values.size == 0:
        return 'none'
    runs = np.split(values, np.flatnonzero(np.diff(values) > 1) + 1)
    return 'ids ' + ', '.join(
        str(run[0]) if len(run) == 1 else '{} to {}'.format(run[0], run[-1]) for run in runs
    )


def column_or_nan(table, name, size):
    """A numeric column, or NaNs where the table does not have it."""
    column = table.get(name)
    if column is None or column.dtype.kind != 'f':
        return np.full(size, np.nan)
    return column


def _column(cells):
    try:
        return np.array([float(cell) if cell.strip() else np.nan for cell in cells], np.float64)
    except ValueError:
        return np.array(cells, dtype=object)
