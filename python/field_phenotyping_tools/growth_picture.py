"""Picture of the growth of one stem, region by region. Heights in metres above the base."""

import matplotlib

matplotlib.use('Agg')  # no display needed
import matplotlib.patheffects as patheffects  # noqa: E402
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.patches import Patch  # noqa: E402

_COLORS = ('tab:blue', 'tab:red', 'tab:green', 'tab:purple', 'tab:orange', 'tab:cyan', 'tab:brown')
_NOT_MERGED = '0.6'
_HATCH = '////'
_BRANCHING = '#ffedad'
_OTHER = '0.65'
_MARGIN = 0.05  # [m] drawn on either side of the stem where it is stretched
_LEAST_DISTANCE = 0.014  # of two labels, share of the height of the picture
_CM = 100.0


def draw_growth(path, plant, growth, stem, other):
    """Draws the regions that a stem was grown in over the plant's points.

    growth: growth.Growth of the plant; stem (n, 3), other (m, 3) [m]: points that the stem kept,
    as the segmenter saw them, and those of other organs. From the left: the whole plant from the
    side; its stem along and across the lean, the width stretched; M of each region; its points.
    """
    stem, other = stem - growth.base, other - growth.base
    start, end = growth.start - growth.base, growth.end - growth.base
    nearest = nearest_region(stem, start, end)

    figure, panels = plt.subplots(
        1,
        5,
        sharey=True,
        figsize=(16.0, 10.5),
        constrained_layout=True,
        gridspec_kw={'width_ratios': (1.5, 1.0, 1.0, 0.8, 1.3)},
    )
    whole, along, across, thresholds, counts = panels
    for axes in panels:
        _shade_branchings(axes, growth, start, end)
    directions = _lean_directions(stem, start, end)
    names = ['azimuth {:.0f}°'.format(_azimuth(direction)) for direction in directions]

    _draw_points(whole, other, stem, nearest, growth, directions[0], 1.0, 3.0)
    whole.set_xlabel('along {} [m]'.format(names[0]))
    whole.set_ylabel('above the base [m]')
    whole.set_title('whole plant')
    for axes, direction, name, title in zip(
        (along, across), directions, names, ('stem along its lean', 'stem across its lean')
    ):
        _draw_points(axes, other, stem, nearest, growth, direction, _CM, 5.0)
        _draw_pairs(axes, growth, start, end, direction)
        axes.set_xlabel('along {} [cm]'.format(name))
        axes.set_title(title + ',\nwidth stretched')
    _limit_width((along, across), directions, np.concatenate([start, end]))
    _draw_thresholds(thresholds, growth, start, end)
    heights = np.concatenate([stem[:, 2], other[:, 2], start[:, 2], end[:, 2], [0.0]])
    pad = 0.03 * np.ptp(heights) + 0.01
    whole.set_ylim(heights.min() - pad, heights.max() + pad)
    _draw_counts(counts, growth, start, end, np.bincount(nearest, minlength=len(growth)))
    for axes in panels:
        axes.axhline(0.0, color='0.4', linewidth=0.8, zorder=0.6)
    figure.suptitle(_heading(plant, growth))
    figure.legend(handles=_legend(growth), loc='lower center', ncol=6, fontsize=9)
    across.set_xlabel(across.get_xlabel() + '\n\n')  # room for the legend
    figure.savefig(path, dpi=120)
    plt.close(figure)


def nearest_region(points, start, end):
    """For each point (n, 3) the region whose start-end line is nearest; empty without regions."""
    if len(start) == 0:
        return np.zeros(0, np.int64)
    line = end - start
    length = np.maximum(np.einsum('rk,rk->r', line, line), 1e-12)
    away = points[:, None, :] - start[None]
    share = np.clip(np.einsum('prk,rk->pr', away, line) / length, 0.0, 1.0)
    distance = np.linalg.norm(away - share[:, :, None] * line[None], axis=2)
    return np.argmin(distance, axis=1)


def _lean_directions(stem, start, end):
    """Horizontal unit vectors along and across (left of) the lean from the base to the top."""
    if len(start):
        lean = end[-1, :2] - start[0, :2]
    else:
        lean = stem[np.argmax(stem[:, 2]), :2] if len(stem) else np.zeros(2)
    size = np.linalg.norm(lean)
    lean = lean / size if size > 0.0 else np.array([1.0, 0.0])
    return lean, np.array([-lean[1], lean[0]])


def _azimuth(direction):
    return np.degrees(np.arctan2(direction[1], direction[0])) % 360.0


def _color(growth, region):
    return _COLORS[region % len(_COLORS)] if growth.merged[region] else _NOT_MERGED


def _draw_points(axes, other, stem, nearest, growth, direction, scale, size):
    axes.plot(
        scale * other[:, :2].dot(direction),
        other[:, 2],
        '.',
        markersize=1.5,
        markeredgewidth=0,
        color=_OTHER,
        zorder=1,
    )
    if len(growth) == 0:
        axes.plot(scale * stem[:, :2].dot(direction), stem[:, 2], 'k.', markersize=size)
    for region in range(len(growth)):
        points = stem[nearest == region]
        axes.plot(
            scale * points[:, :2].dot(direction),
            points[:, 2],
            '.',
            markersize=size,
            markeredgewidth=0,
            color=_color(growth, region),
            zorder=2,
        )


def _draw_pairs(axes, growth, start, end, direction):
    """The line from the start to the end point of each region."""
    for region in range(len(growth)):
        pair = np.array([start[region], end[region]])
        merged = growth.merged[region]
        outline = [patheffects.withStroke(linewidth=2.4, foreground='black')]
        axes.plot(
            _CM * pair[:, :2].dot(direction),
            pair[:, 2],
            'o-' if merged else 'o--',
            color=_color(growth, region),
            markersize=3.5,
            markeredgecolor='black',
            markeredgewidth=0.6,
            linewidth=1.4,
            path_effects=outline if merged else None,
            zorder=3,
        )


def _limit_width(panels, directions, ends):
    """The stem in the middle, both panels to one scale."""
    spans = [ends[:, :2].dot(direction) if len(ends) else np.zeros(1) for direction in directions]
    half = 0.5 * max(np.ptp(span) for span in spans) + _MARGIN
    for axes, span in zip(panels, spans):
        middle = 0.5 * (span.min() + span.max())
        axes.set_xlim(_CM * (middle - half), _CM * (middle + half))


def _shade_branchings(axes, growth, start, end):
    for region in np.flatnonzero(growth.branching):
        axes.axhspan(start[region, 2], end[region, 2], color=_BRANCHING, linewidth=0, zorder=0.5)


def _bars(axes, growth, start, end, widths, solid):
    for region, width in enumerate(widths):
        merged = growth.merged[region]
        axes.barh(
            start[region, 2],
            width,
            height=end[region, 2] - start[region, 2],
            align='edge',
            facecolor=_color(growth, region) if merged and solid else 'white',
            alpha=0.75,
            edgecolor=_color(growth, region),
            hatch=None if merged else _HATCH,
            linewidth=1.0,
            zorder=2,
        )


def _draw_thresholds(axes, growth, start, end):
    """M of each region as steps over the height, and that of the whole stem."""
    _bars(axes, growth, start, end, growth.M, True)
    axes.axvline(growth.summary['M'], color='black', linestyle='--', linewidth=1, zorder=4)
    if len(growth):
        steps = np.repeat(growth.M, 2)
        heights = np.column_stack([start[:, 2], end[:, 2]]).ravel()
        axes.plot(steps, heights, color='black', linewidth=1.4, zorder=3)
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks([0.0, 0.25, 0.5, 0.75])
    axes.set_xlabel('similarity threshold M [-]')
    axes.set_title('M of each region')


def _draw_counts(axes, growth, start, end, kept):
    _bars(axes, growth, start, end, growth.points, False)
    _bars(axes, growth, start, end, kept[: len(growth)], True)
    most = max([1, *growth.points, *kept])
    least = _LEAST_DISTANCE * np.ptp(axes.get_ylim())
    heights = _spread(0.5 * (start[:, 2] + end[:, 2]), least)
    for region in range(len(growth)):
        longest = max(kept[region], growth.points[region])
        # At one place, so that labels moved off thin regions do not lie on their neighbours' bars.
        axes.annotate(
            '{}: {} / {}'.format(region, kept[region], growth.points[region]),
            xy=(longest, 0.5 * (start[region, 2] + end[region, 2])),
            xytext=(1.06 * most, heights[region]),
            va='center',
            fontsize=7,
            arrowprops={'arrowstyle': '-', 'color': '0.75', 'linewidth': 0.5},
            zorder=1,
        )
    if len(growth) == 0:
        axes.annotate('no regions', (0.5, 0.5), xycoords='axes fraction', ha='center')
    axes.set_xlim(0.0, 1.5 * most)
    axes.set_xlabel('points [count]')
    axes.set_title('region: points kept in the stem (full)\n/ grown (outline)')


def _spread(heights, least):
    """Ascending heights moved apart to at least that distance, each near its place."""
    spread = np.array(heights, float)
    for _ in range(200):
        short = least - np.diff(spread)
        if not np.any(short > 1e-6):
            break
        push = 0.5 * np.maximum(short, 0.0)
        spread[1:] += push
        spread[:-1] -= push
    return spread


def _heading(plant, growth):
    x, y, _ = growth.base
    return (
        'plant {} at x {:.2f} m, y {:.2f} m: {} regions, {} of them branchings, {} not merged\n'
        'Q {quality:.3f}, iterations {iterations:.0f}, r1 {r1:.3f} m, M {M:.3f}, '
        'alpha {alpha:.3f}, beta {beta:.3f}'.format(
            plant,
            x,
            y,
            len(growth),
            int(growth.branching.sum()),
            int((~growth.merged).sum()),
            **growth.summary
        )
    )


def _legend(growth):
    colored = _COLORS[0]
    return [
        Line2D([], [], marker='.', linestyle='', color=colored, label='stem points of a region'),
        Line2D([], [], marker='.', linestyle='', color=_OTHER, label='other organs'),
        Line2D(
            [],
            [],
            marker='o',
            color=colored,
            markeredgecolor='black',
            markersize=4,
            label='from start to end point of a region',
        ),
        Patch(color=_BRANCHING, label='branching'),
        Patch(facecolor='white', edgecolor=_NOT_MERGED, hatch=_HATCH, label='did not merge'),
        Line2D(
            [],
            [],
            color='black',
            linestyle='--',
            linewidth=1,
            label='M of the stem: {:.3f}'.format(growth.summary['M']),
        ),
    ]
