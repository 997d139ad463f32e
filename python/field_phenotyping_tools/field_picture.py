"""Pictures of a segmented field and of one plant. Axes in metres."""

import colorsys

import matplotlib

matplotlib.use('Agg')  # no display needed
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.patches import Ellipse  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

from .segmentation_scores import NO_PART, OTHER_ORGAN, STEM  # noqa: E402

SLICE_HALF_HEIGHT = 0.025  # [m] of stem drawn above and below the measuring height
_DRAWN_POINTS = {NO_PART: 60000, OTHER_ORGAN: 150000, STEM: 80000}
_MOST_IDS_FROM_THE_SIDE = 40  # with more, rows behind one another hide the ids
_FAR = 1000.0  # [m] coordinates beyond this are drawn relative to a round offset
_GOLDEN_RATIO = 0.6180339887498949


def draw_field(path, positions, labels, plants, view='both', heading=''):
    """Draws the labelled cloud from above, from the side (across the long edge), or both.

    positions (n, 3) [m]; labels: structured with plant_id and part; plants: {id: base (3,)} [m].
    Ground grey, stems in the full and other organs in the pale colour of their plant; ids at bases.
    """
    finite = np.all(np.isfinite(positions), axis=1)
    positions, labels = positions[finite], labels[finite]
    offset = _offset(positions, plants)
    positions = positions - offset
    bases = {plant: np.asarray(base) - offset for plant, base in plants.items()}
    along, across = _long_edge_first(positions)
    panels = {
        'top': [(along, across)],
        'side': [(along, 2)],
        'both': [(along, across), (along, 2)],
    }[view]
    kept = _thinned(labels['part'])
    positions, labels = positions[kept], labels[kept]
    colors = _colors(labels)
    shapes = [
        (
            max(np.ptp(positions[:, v]) / max(np.ptp(positions[:, h]), 1e-3), 0.12)
            if len(positions)
            else 0.5
        )
        for h, v in panels
    ]
    width = 14.0
    figure, axes = plt.subplots(
        len(panels),
        1,
        squeeze=False,
        constrained_layout=True,
        figsize=(width, min(sum(shapes) * width * 0.92 + 0.9 * len(panels), 24.0)),
        gridspec_kw={'height_ratios': shapes},
    )
    for axis, (h, v) in zip(axes[:, 0], panels):
        _draw_panel(axis, positions, labels['part'], colors, h, v)
        if v != 2 or len(bases) <= _MOST_IDS_FROM_THE_SIDE:
            _draw_ids(axis, bases, h, v)
        axis.set_aspect('equal')
        axis.set_xlabel(_axis_name(h, offset))
        axis.set_ylabel(_axis_name(v, offset))
        axis.ticklabel_format(useOffset=False, style='plain')
    axes[0, 0].set_title('{}{} plants'.format(heading and heading + ': ', len(plants)))
    figure.savefig(path, dpi=130)
    plt.close(figure)


def draw_plant(path, positions, labels, plant, base, traits):
    """Draws one plant from the side, and its stem's cross-section at the measuring height.

    traits: name -> value [m]; uses height, diameter_height, stem_diameter, stem_diameter_minor and
    stem_diameter_stddev, any of them NaN. The ellipse has the reported axes; its centre and
    direction, which the table does not hold, are fitted here to the points drawn.
    """
    own = labels['plant_id'] == plant
    local = positions[own] - base
    part = labels['part'][own]
    figure, (side, section) = plt.subplots(1, 2, figsize=(13.0, 8.0), constrained_layout=True)
    direction = _widest_direction(local[:, :2])
    flat = np.column_stack([local[:, :2].dot(direction), local[:, 2]])
    color = _plant_color(plant)
    for kind, shade, name in ((OTHER_ORGAN, _pale(color), 'other organs'), (STEM, color, 'stem')):
        points = flat[part == kind]
        side.plot(
            points[:, 0],
            points[:, 1],
            '.',
            markersize=2,
            color=shade,
            label='{} ({} points)'.format(name, len(points)),
        )
    _draw_heights(side, traits)
    side.set_aspect('equal', adjustable='datalim')
    side.set_xlabel(
        'along azimuth {:.0f} deg, from the base [m]'.format(
            np.degrees(np.arctan2(direction[1], direction[0]))
        )
    )
    side.set_ylabel('above the base [m]')
    side.legend(loc='upper right', fontsize=8, markerscale=4)
    side.set_title('plant {} at x {:.2f} m, y {:.2f} m'.format(plant, base[0], base[1]))
    _draw_section(section, local[part == STEM], traits)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def fit_placement(points, semi_major, semi_minor):
    """Centre (2,) and direction [rad] of the ellipse of given semi-axes nearest to points (n, 2).

    Least squares of the first-order distance to the ellipse, robust to stray points, from four
    starting directions.
    """

    def distances(parameters):
        x, y = _in_frame(points - parameters[:2], parameters[2])
        value = (x / semi_major) ** 2 + (y / semi_minor) ** 2
        slope = 2.0 * np.hypot(x / semi_major**2, y / semi_minor**2)
        return (value - 1.0) / np.maximum(slope, 1e-9)

    start = np.median(points, axis=0)
    fits = [
        least_squares(
            distances,
            [start[0], start[1], angle],
            loss='soft_l1',
            f_scale=0.002,
            x_scale=[0.01, 0.01, 0.5],
        )
        for angle in np.arange(4) * np.pi / 4.0
    ]
    best = min(fits, key=lambda fit: fit.cost)
    return best.x[:2], float(np.mod(best.x[2], np.pi))


def _in_frame(points, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * points[:, 0] + sine * points[:, 1], cosine * points[:, 1] - sine * points[:, 0]


def _draw_heights(axes, traits):
    for name, title, color in (
        ('height', 'height', 'tab:blue'),
        ('diameter_height', 'diameter taken at', 'tab:red'),
    ):
        value = traits.get(name, np.nan)
        if np.isfinite(value):
            axes.axhline(
                value,
                color=color,
                linewidth=1,
                linestyle='--',
                label='{} {:.3f} m'.format(title, value),
            )
    axes.axhline(0.0, color='0.5', linewidth=1)


def _draw_section(axes, stem, traits):
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_xlabel('x from the centre of the points [mm]')
    axes.set_ylabel('y from the centre of the points [mm]')
    at = traits.get('diameter_height', np.nan)
    if not np.isfinite(at):
        axes.set_title('no diameter was measured')
        return
    points = stem[np.abs(stem[:, 2] - at) <= SLICE_HALF_HEIGHT, :2]
    axes.set_title(
        'stem within ±{:.0f} mm of {:.3f} m, {} points'.format(
            1000.0 * SLICE_HALF_HEIGHT, at, len(points)
        )
    )
    if len(points) == 0:
        return
    centre = np.median(points, axis=0)
    points = points - centre
    axes.plot(1000.0 * points[:, 0], 1000.0 * points[:, 1], '.', color='tab:green', markersize=5)
    major, minor = traits.get('stem_diameter', np.nan), traits.get('stem_diameter_minor', np.nan)
    if not np.isfinite(major):
        return
    minor = minor if np.isfinite(minor) else major
    stddev = traits.get('stem_diameter_stddev', np.nan)
    spread = ' (±{:.1f})'.format(1000.0 * stddev) if np.isfinite(stddev) else ''
    middle, angle = np.zeros(2), 0.0
    if len(points) >= 3:
        middle, angle = fit_placement(points, 0.5 * major, 0.5 * minor)
    axes.add_patch(
        Ellipse(
            1000.0 * middle,
            1000.0 * major,
            1000.0 * minor,
            angle=np.degrees(angle),
            fill=False,
            color='tab:red',
            linewidth=1.5,
            label='reported: {:.1f}{} x {:.1f} mm,\nplaced on these points'.format(
                1000.0 * major, spread, 1000.0 * minor
            ),
        )
    )
    axes.legend(loc='upper right', fontsize=9)


def _offset(positions, plants):
    """A round offset for coordinates too large to read; zero otherwise."""
    points = positions if len(positions) else np.array(list(plants.values())).reshape(-1, 3)
    if len(points) == 0:
        return np.zeros(3)
    low = np.nanmin(points, axis=0)
    return np.where(np.abs(low) > _FAR, np.floor(low), 0.0)


def _axis_name(axis, offset):
    name = 'xyz'[axis]
    return (
        '{} [m]'.format(name)
        if offset[axis] == 0.0
        else '{} - {:.0f} m [m]'.format(name, offset[axis])
    )


def _long_edge_first(positions):
    return (
        (1, 0) if len(positions) and np.ptp(positions[:, 1]) > np.ptp(positions[:, 0]) else (0, 1)
    )


def _thinned(part):
    """Indices of the points drawn: every k-th of each part."""
    kept = []
    for kind, limit in _DRAWN_POINTS.items():
        members = np.flatnonzero(part == kind)
        kept.append(members[:: max(1, -(-len(members) // limit))])
    return np.sort(np.concatenate(kept))


def _colors(labels):
    colors = np.full((len(labels), 3), 0.62)
    for plant in np.unique(labels['plant_id']):
        color = _plant_color(plant) if plant >= 0 else (0.35, 0.35, 0.35)
        own = labels['plant_id'] == plant
        colors[own & (labels['part'] == STEM)] = color
        colors[own & (labels['part'] == OTHER_ORGAN)] = _pale(color)
    return colors


def _plant_color(plant):
    """Neighbouring ids get hues far apart."""
    return colorsys.hsv_to_rgb((int(plant) * _GOLDEN_RATIO) % 1.0, 1.0, 0.78)


def _pale(color):
    return tuple(0.45 * channel + 0.55 for channel in color)


def _draw_panel(axes, positions, part, colors, h, v):
    for kind, size in ((NO_PART, 2.0), (OTHER_ORGAN, 3.0), (STEM, 6.0)):
        drawn = part == kind
        axes.scatter(
            positions[drawn, h],
            positions[drawn, v],
            c=colors[drawn],
            s=size,
            marker='.',
            linewidths=0,
        )


def _draw_ids(axes, bases, h, v):
    for plant, base in bases.items():
        if np.isfinite(base[h]) and np.isfinite(base[v]):
            axes.annotate(
                str(plant),
                (base[h], base[v]),
                (0, -7),
                textcoords='offset points',
                fontsize=7 if len(bases) < 300 else 4,
                ha='center',
                va='top',
                fontweight='bold',
            )


def _widest_direction(xy):
    if len(xy) < 2:
        return np.array([1.0, 0.0])
    values, vectors = np.linalg.eigh(np.cov(xy.T))
    return vectors[:, np.argmax(values)]
