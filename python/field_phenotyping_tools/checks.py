"""Conditions on figures, such as `recall>=0.95`."""

import operator
import re

from .errors import InputError

_COMPARISONS = {
    '<=': operator.le,
    '>=': operator.ge,
    '==': operator.eq,
    '!=': operator.ne,
    '<': operator.lt,
    '>': operator.gt,
}
_CONDITION = re.compile(r'^\s*(\w+)\s*(<=|>=|==|!=|<|>)\s*(\S+)\s*$')


def failed_checks(figures, conditions):
    """One line for each condition not met; a figure that is NaN or missing fails too.

    Raises InputError for a condition that cannot be read. A figure that this evaluation does not
    have, such as stem_f1 of a run without labels.pcd, is a failure and not an error.
    """
    failures = []
    for condition in conditions:
        name, comparison, limit = parse(condition)
        if name not in figures:
            failures.append(
                '{}: no figure {} here; there are {}'.format(
                    condition, name, ', '.join(sorted(figures))
                )
            )
        elif figures[name] != figures[name]:
            failures.append('{}: {} could not be computed'.format(condition, name))
        elif not _COMPARISONS[comparison](figures[name], limit):
            failures.append('{}: {} is {:.6g}'.format(condition, name, figures[name]))
    return failures


def parse(condition):
    """(figure, comparison, limit) of a condition."""
    match = _CONDITION.match(condition)
    try:
        if match:
            return match.group(1), match.group(2), float(match.group(3))
    except ValueError:
        pass
    raise InputError(
        'Cannot read the check "{}". Write FIGURE>=NUMBER, in metres and radians, as '
        'in "recall>=0.95"; the comparisons are <= >= == != < >.'.format(condition)
    )
