"""Agreement of a measured trait with its truth."""

import numpy as np

CONFIDENCE_FACTOR = 1.96  # standard deviations either side that hold 95 % of a normal distribution


def score_trait(truth, estimate, stddev=None):
    """Scores paired values, in the unit of the values; pairs that are not finite are left out.

    R2 = 1 - SS_res / SS_tot and can be negative; squared_correlation is Pearson's r squared,
    blind to bias and scale. Errors are estimate - truth. coverage is the share of the pairs with
    a standard deviation whose truth lies within +-1.96 of it. A score that is not defined is NaN.
    """
    truth, estimate = np.asarray(truth, float), np.asarray(estimate, float)
    both = np.isfinite(truth) & np.isfinite(estimate)
    z = z_scores(truth, estimate, stddev)
    truth, estimate = truth[both], estimate[both]
    error = estimate - truth
    scores = {
        'n': int(error.size),
        'r2': np.nan,
        'squared_correlation': np.nan,
        'rmse': np.nan,
        'mae': np.nan,
        'bias': np.nan,
        'median_abs_error': np.nan,
        'n_with_stddev': int(z.size),
        'coverage': np.nan,
    }
    if error.size:
        scores['rmse'] = float(np.sqrt(np.mean(error**2)))
        scores['mae'] = float(np.mean(np.abs(error)))
        scores['bias'] = float(np.mean(error))
        scores['median_abs_error'] = float(np.median(np.abs(error)))
    if z.size:
        scores['coverage'] = float(np.mean(np.abs(z) <= CONFIDENCE_FACTOR))
    total = np.sum((truth - truth.mean()) ** 2) if error.size > 1 else 0.0
    if total > 0.0:
        scores['r2'] = float(1.0 - np.sum(error**2) / total)
        if np.ptp(estimate) > 0.0:
            scores['squared_correlation'] = float(np.corrcoef(truth, estimate)[0, 1] ** 2)
    return scores


def z_scores(truth, estimate, stddev):
    """(estimate - truth) / stddev of the pairs that have a positive standard deviation."""
    if stddev is None:
        return np.empty(0)
    truth, estimate, stddev = (np.asarray(values, float) for values in (truth, estimate, stddev))
    usable = np.isfinite(truth) & np.isfinite(estimate) & np.isfinite(stddev)
    usable[usable] &= stddev[usable] > 0.0
    return (estimate[usable] - truth[usable]) / stddev[usable]
