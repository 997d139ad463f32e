"""Plots of measured against true values, and of scores. Units on the axes."""

import matplotlib

matplotlib.use('Agg')  # no display needed
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.ticker import NullFormatter  # noqa: E402

from . import traits  # noqa: E402
from .reporting import TRAIT_UNITS  # noqa: E402

_MATCHED, _MISSED, _FALSE = 'matched', 'missed', 'false'


def write_plots(folder, rows):
    """Writes height.png, stem_diameter.png, field_errors.png and coverage.png; returns their paths.

    rows: those of evaluation.Report for a field. A plot without any value says so.
    """
    paths = [
        str(folder) + '/' + name
        for name in ('height.png', 'stem_diameter.png', 'field_errors.png', 'coverage.png')
    ]
    scatter(paths[0], rows, 'height')
    scatter(paths[1], rows, 'stem_diameter')
    field_errors(paths[2], rows)
    coverage(paths[3], rows)
    return paths


def scatter(path, rows, trait):
    """Measured against true values with 1:1 line, fitted line and scores (form of Fig. 15)."""
    title, unit, scale, decimals = TRAIT_UNITS[trait]
    truth, estimate, stddev = (scale * values for values in _values(rows, trait))
    figure, axes = plt.subplots(figsize=(6.0, 6.0), constrained_layout=True)
    scores = traits.score_trait(truth, estimate, stddev)
    shown = np.isfinite(truth) & np.isfinite(estimate)
    truth, estimate, stddev = truth[shown], estimate[shown], stddev[shown]
    if truth.size:
        axes.errorbar(
            truth,
            estimate,
            np.nan_to_num(stddev),
            fmt='o',
            markersize=4,
            color='tab:green',
            ecolor='0.75',
            elinewidth=1,
            capsize=0,
            label='plants, bars: reported std. dev.',
        )
        low = min(truth.min(), estimate.min())
        high = max(truth.max(), estimate.max())
        pad = 0.05 * (high - low) or 1.0
        span = np.array([low - pad, high + pad])
        axes.plot(span, span, '--', color='0.3', label='1:1')
        if np.ptp(truth) > 0.0:
            slope, offset = np.polyfit(truth, estimate, 1)
            axes.plot(
                span,
                slope * span + offset,
                color='tab:red',
                label='fit: {:.3f} x {:+.{}f}'.format(slope, offset, decimals),
            )
        axes.set_xlim(span)
        axes.set_ylim(span)
        axes.plot(
            [],
            [],
            ' ',
            label='R² = {:.3f}, r² = {:.3f}'.format(scores['r2'], scores['squared_correlation']),
        )
        axes.plot(
            [],
            [],
            ' ',
            label='RMSE = {:.{d}f} {u}, bias = {:+.{d}f} {u}, n = {}'.format(
                scores['rmse'], scores['bias'], scores['n'], d=decimals, u=unit
            ),
        )
        axes.legend(loc='best', fontsize=9)
    else:
        _say_empty(axes)
    axes.set_aspect('equal')
    axes.set_xlabel('true {} [{}]'.format(title, unit))
    axes.set_ylabel('measured {} [{}]'.format(title, unit))
    axes.grid(alpha=0.3)
    _save(figure, path)


def field_errors(path, rows):
    """Map of the errors of height and diameter, with the missed and the false plants."""
    figure, panels = plt.subplots(2, 1, figsize=(10.0, 7.0), constrained_layout=True)
    position = np.array([(row['x'], row['y']) for row in rows], float).reshape(-1, 2)
    status = np.array([row['status'] for row in rows])
    if len(position) and np.ptp(position[:, 1]) > np.ptp(position[:, 0]):
        position = position[:, ::-1]
        labels = ('y', 'x')
    else:
        labels = ('x', 'y')
    for axes, trait in zip(panels, ('height', 'stem_diameter')):
        title, unit, scale, _ = TRAIT_UNITS[trait]
        error = scale * np.array([row.get(trait + '_error', np.nan) for row in rows], float)
        known = (status == _MATCHED) & np.isfinite(error)
        limit = np.percentile(np.abs(error[known]), 98) if known.any() else 1.0
        shown = axes.scatter(
            position[known, 0],
            position[known, 1],
            c=error[known],
            cmap='coolwarm',
            vmin=-limit or -1.0,
            vmax=limit or 1.0,
            edgecolors='0.3',
            linewidths=0.4,
            s=45,
        )
        figure.colorbar(shown, ax=axes, label='error of {} [{}]'.format(title, unit), extend='both')
        for mask, marker, color, label in (
            ((status == _MATCHED) & ~known, 'o', '0.6', 'not measured'),
            (status == _MISSED, 'x', 'black', 'missed'),
            (status == _FALSE, '+', 'red', 'false'),
        ):
            if mask.any():
                axes.scatter(
                    position[mask, 0],
                    position[mask, 1],
                    marker=marker,
                    c=color,
                    s=45,
                    label='{} ({})'.format(label, int(mask.sum())),
                )
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc='best', fontsize=8)
        axes.set_aspect('equal', adjustable='datalim')
        axes.margins(0.05, 0.2)
        axes.ticklabel_format(useOffset=False, style='plain')
        axes.set_xlabel('{} [m]'.format(labels[0]))
        axes.set_ylabel('{} [m]'.format(labels[1]))
    _save(figure, path)


def coverage(path, rows):
    """Histograms of error / reported standard deviation beside the normal distribution."""
    figure, panels = plt.subplots(1, 2, figsize=(10.0, 4.2), constrained_layout=True)
    edges = np.linspace(-6.0, 6.0, 49)
    curve = np.linspace(-6.0, 6.0, 241)
    for axes, trait in zip(panels, ('height', 'stem_diameter')):
        z = traits.z_scores(*_values(rows, trait))
        if z.size:
            share = np.mean(np.abs(z) <= traits.CONFIDENCE_FACTOR)
            beyond = int(np.sum(np.abs(z) > edges[-1]))
            axes.hist(
                np.clip(z, edges[0], edges[-1]),
                edges,
                density=True,
                color='tab:green',
                alpha=0.7,
                label='n = {}, coverage {:.3f} (aim 0.95)\n{} beyond ±6'.format(
                    z.size, share, beyond
                ),
            )
            axes.plot(
                curve,
                np.exp(-0.5 * curve**2) / np.sqrt(2.0 * np.pi),
                color='0.2',
                label='standard normal',
            )
            for limit in (-traits.CONFIDENCE_FACTOR, traits.CONFIDENCE_FACTOR):
                axes.axvline(limit, color='tab:red', linestyle='--', linewidth=1)
            axes.set_ylim(0.0, 1.3 * axes.get_ylim()[1])  # room for the legend
            axes.legend(loc='upper left', fontsize=8)
        else:
            _say_empty(axes)
        axes.set_xlabel('error / reported standard deviation [-]')
        axes.set_ylabel('density [-]')
        axes.set_title(TRAIT_UNITS[trait][0])
    _save(figure, path)


def similarity_sweep(path, values, scores, paper_values, paper_scores):
    """Scores over the similarity threshold M, beside the paper's (form of Table 1).

    scores, paper_scores: {title: scores [%]} at `values` and `paper_values` of M.
    """
    figure, axes = plt.subplots(figsize=(7.0, 5.0), constrained_layout=True)
    for color, title in zip(('tab:green', 'tab:blue', 'tab:orange', 'tab:red'), scores):
        axes.plot(values, scores[title], 'o-', color=color, label=title)
        axes.plot(
            paper_values,
            paper_scores[title],
            '--',
            color=color,
            alpha=0.5,
            label=title + ', paper, its own field',
        )
    axes.legend(loc='best', fontsize=8, ncol=2)
    axes.set_xlabel('similarity threshold M [-]')
    axes.set_ylabel('score [%]')
    axes.grid(alpha=0.3)
    _save(figure, path)


def completion_gaps(path, figures, goals):
    """Quality before and after completion, and the error of what was filled, by kind of gap.

    figures: {kind of gap: figures of completion_benchmark.summarise()}; goals: the least of each
    """
    figure, (quality, error) = plt.subplots(1, 2, figsize=(11.0, 4.5), constrained_layout=True)
    names = list(figures)
    places = np.arange(len(names))
    for k, (name, color) in enumerate((('pc', 'tab:green'), ('sm', 'tab:blue'), ('rd', 'tab:red'))):
        left = places + 0.27 * (k - 1)
        after = [figures[gap].get(name, np.nan) for gap in names]
        before = [figures[gap].get('before_' + name, np.nan) for gap in names]
        quality.bar(left, after, 0.25, color=color, alpha=0.35, label=name.upper() + ' after')
        quality.bar(left, before, 0.25, color=color, label=name.upper() + ' before')
        quality.axhline(goals[name], color=color, linestyle=':', linewidth=1.0)
    quality.set_ylabel('share [-]; dotted: goals')
    quality.legend(fontsize=7, ncol=3, loc='lower center')
    error.bar(places, [1e3 * figures[gap].get('rmse', np.nan) for gap in names], 0.6)
    error.axhline(1e3 * goals['rmse'], color='0.3', linestyle=':')
    error.set_ylabel('RMSE of filled points to the true surface [mm]')
    for axes in (quality, error):
        axes.set_xticks(places)
        axes.set_xticklabels(names, rotation=25, ha='right', fontsize=8)
        axes.grid(alpha=0.3, axis='y')
    _save(figure, path)


def estimator_curves(path, curves, most_of_bound):
    """Bias, RMSE over the Cramer-Rao bound, and coverage of the diameter, by what is varied.

    curves: {axis: [(value, figures of measurement_benchmark.summarise_pieces())]}
    """
    figure, panels = plt.subplots(
        3, len(curves), figsize=(3.4 * len(curves), 8.0), constrained_layout=True, squeeze=False
    )
    for k, (axis, points) in enumerate(curves.items()):
        values = [value for value, _ in points]

        def drawn(row, name, scale, **style):
            panels[row, k].plot(
                values, [scale * rows.get(name, np.nan) for _, rows in points], 'o-', **style
            )

        drawn(0, 'circle_bias', 1e3, color='0.6', label='circle')
        drawn(0, 'bias', 1e3, color='tab:green', label='ours')
        panels[0, k].axhline(0.0, color='0.3', linewidth=1)
        panels[0, k].set_ylim(-3.0, 6.0)
        drawn(1, 'of_bound', 1.0, color='tab:green')
        panels[1, k].axhline(1.0, color='0.3', linewidth=1)
        panels[1, k].axhline(most_of_bound, color='tab:red', linestyle='--', linewidth=1)
        panels[1, k].set_ylim(0.0, 3.0)
        drawn(2, 'coverage', 1.0, color='tab:green')
        panels[2, k].axhline(0.95, color='0.3', linewidth=1)
        panels[2, k].set_ylim(0.6, 1.0)
        for row, label in enumerate(
            ('bias of 2a [mm]', 'RMSE / Cramer-Rao bound [-]', 'coverage of ±1.96 σ [-]')
        ):
            panels[row, k].set_xlabel(axis)
            panels[row, k].set_ylabel(label if k == 0 else '')
            panels[row, k].grid(alpha=0.3)
            if axis.startswith('points'):
                panels[row, k].set_xscale('log')
    panels[0, 0].legend(fontsize=8)
    _save(figure, path)


def diameter_scatter(path, fields):
    """Measured against true diameters with their bars; fields: [(title, truth, value, stddev)]."""
    figure, panels = plt.subplots(
        1, len(fields), figsize=(4.2 * len(fields), 4.4), constrained_layout=True, squeeze=False
    )
    for axes, (title, truth, value, stddev) in zip(panels[0], fields):
        axes.errorbar(
            1e3 * truth,
            1e3 * value,
            1.96e3 * np.nan_to_num(stddev),
            fmt='o',
            markersize=3,
            color='tab:green',
            ecolor='0.8',
            elinewidth=1,
        )
        span = np.array([1e3 * np.min(truth) - 1.0, 1e3 * np.max(truth) + 1.0])
        axes.plot(span, span, '--', color='0.3')
        axes.set_ylim(span[0] - 3.0, span[1] + 3.0)
        axes.set_title(title, fontsize=9)
        axes.set_xlabel('true stem diameter [mm]')
        axes.set_ylabel('measured, ±1.96 σ [mm]')
        axes.grid(alpha=0.3)
    _save(figure, path)


def pipeline_stages(path, figures):
    """Seconds of the stages, added up over the blocks, by growth stage and device.

    figures: {label: figures of pipeline_benchmark.stages()}
    """
    figure, axes = plt.subplots(figsize=(8.0, 4.2), constrained_layout=True)
    places = np.arange(len(figures))
    left = np.zeros(len(figures))
    for stage, color in zip(
        ('preprocessing', 'segmentation', 'completion', 'measurement'),
        ('tab:brown', 'tab:green', 'tab:red', 'tab:blue'),
    ):
        seconds = np.array([row['stages_s'][stage] for row in figures.values()])
        axes.barh(places, seconds, 0.7, left=left, color=color, alpha=0.8, label=stage)
        left = left + seconds
    axes.plot([row['median_s'] for row in figures.values()], places, 'k|', ms=16, label='wall time')
    axes.set_yticks(places)
    axes.set_yticklabels(list(figures), fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel('seconds of all blocks together [s]')
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3, axis='x')
    _save(figure, path)


def pipeline_rivals(path, figures):
    """How many times as long as ours the Point Cloud Library takes, stage by stage.

    figures: {label: figures of pipeline_benchmark.compare_stages()}
    """
    figure, axes = plt.subplots(figsize=(8.0, 3.2), constrained_layout=True)
    rows = {label: row for label, row in figures.items() if row['method'].startswith('pcl::')}
    places = np.arange(len(rows))
    axes.barh(places, [row['ratio'] for row in rows.values()], 0.7, color='0.6')
    axes.axvline(1.0, color='tab:green', linewidth=2, label='ours')
    axes.legend(fontsize=8)
    axes.set_xscale('log')
    axes.set_yticks(places)
    axes.set_yticklabels(list(rows), fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel('times as long as our stage [-]')
    axes.grid(alpha=0.3, axis='x', which='both')
    _save(figure, path)


def pipeline_scaling(path, figures, unit):
    """Seconds and memory by the number of points, beside what grows in proportion.

    figures: {label: figures of pipeline_benchmark.plants() or points()}; unit: of the labels
    """
    figure, panels = plt.subplots(1, 2, figsize=(8.0, 3.4), constrained_layout=True)
    points = np.array([row['points'] for row in figures.values()], float)
    for axes, name, scale, label in (
        (panels[0], 'median_s', 1.0, 'seconds [s]'),
        (panels[1], 'bytes', 1e-6, 'most memory [MB]'),
    ):
        values = scale * np.array([row[name] for row in figures.values()])
        axes.loglog(points, values[0] * points / points[0], '--', color='0.5', label='in proportion')
        axes.loglog(points, values, 'o-', color='tab:green', label='measured')
        for at, value, text in zip(points, values, figures):
            axes.annotate(
                '{} {}'.format(text, unit).strip(),
                (at, value),
                textcoords='offset points',
                xytext=(-6, 4),
                ha='right',
                fontsize=7,
            )
        axes.set_xlim(points[0] / 3.0, points[-1] * 1.5)  # room for what is left of the first
        axes.xaxis.set_minor_formatter(NullFormatter())  # its labels would overlap
        axes.set_xlabel('points [-]')
        axes.set_ylabel(label)
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3, which='both')
    _save(figure, path)


def _values(rows, trait):
    matched = [row for row in rows if row['status'] == _MATCHED]
    return [
        np.array([row.get(trait + part, np.nan) for row in matched], float)
        for part in ('_truth', '', '_stddev')
    ]


def _say_empty(axes):
    axes.text(
        0.5,
        0.5,
        'no plant with both values',
        ha='center',
        va='center',
        transform=axes.transAxes,
        color='0.4',
    )


def _save(figure, path):
    figure.savefig(path, dpi=130)
    plt.close(figure)
