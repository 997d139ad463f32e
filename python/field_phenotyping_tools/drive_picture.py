"""A moving picture of a drive: points as the sensor gives them, plants as they are reported."""

import sqlite3

import matplotlib

matplotlib.use('Agg')  # no display needed
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import LineCollection  # noqa: E402
from matplotlib.colors import LinearSegmentedColormap  # noqa: E402
from scipy.spatial.transform import Rotation, Slerp  # noqa: E402

from .errors import InputError  # noqa: E402
from .tables import read_table  # noqa: E402

FRAMES_PER_SECOND = 8
_POINTS = 40000  # drawn of a whole drive
_DEPTH = np.array([0.25, 0.35])  # what a metre away from the viewer moves a point [m]
_BACKGROUND = '#1e1e1e'
_COLORS = ['#6b5a48', '#557a55', '#8aa88a']  # of points, from the soil up: paler than the plants' bars


class Transforms:
    """The transforms of a bag: where a frame was in another at a time."""

    def __init__(self):
        self._samples = {}  # {child: (parent, [(time, position, quaternion)])}
        self._static = set()
        self._curves = {}

    def add(self, transform, static=False):
        """transform: geometry_msgs/TransformStamped."""
        child = transform.child_frame_id.strip('/')
        t, q = transform.transform.translation, transform.transform.rotation
        _, samples = self._samples.setdefault(child, (transform.header.frame_id.strip('/'), []))
        samples.append(
            (transform.header.stamp.to_sec(), [t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
        )
        if static:
            self._static.add(child)

    def to(self, target, frame, time, points):
        """Points (n, 3) of `frame` at that time [s] in `target`; None where no transform leads there.

        Transforms are followed upwards from the sensor's frame, as SLAM packages lay them.
        """
        frame, target = frame.strip('/'), target.strip('/')
        for _ in range(len(self._samples) + 1):
            if frame == target:
                return points
            if frame not in self._samples:
                return None
            pose = self._pose(frame, time)
            if pose is None:
                return None
            points = pose[0].apply(points) + pose[1]
            frame = self._samples[frame][0]
        return None

    def _pose(self, child, time):
        _, samples = self._samples[child]
        if child in self._static or len(samples) == 1:
            return Rotation.from_quat(samples[-1][2]), np.array(samples[-1][1])
        if child not in self._curves:
            unique = {sample[0]: sample for sample in samples}
            times = np.array(sorted(unique))
            positions = np.array([unique[time][1] for time in times])
            turns = Slerp(times, Rotation.from_quat([unique[time][2] for time in times]))
            self._curves[child] = times, positions, turns
        times, positions, turns = self._curves[child]
        if not times[0] <= time <= times[-1]:
            return None
        place = [np.interp(time, times, positions[:, k]) for k in range(3)]
        return turns(time), np.array(place)


def read_drive(path, points_topic, target_frame, progress=lambda text: None):
    """(times [s] of the scans, points (n, 3) [m] of each, sensor's places (n, 3)), thinned for drawing."""
    try:
        import rosbag
        from sensor_msgs import point_cloud2
    except ImportError:
        raise InputError('Reading a bag needs ROS: start this through rosrun or scripts/env.')
    try:
        bag = rosbag.Bag(path)
    except (OSError, rosbag.ROSBagException) as error:
        raise InputError('Cannot read the bag {}: {}.'.format(path, error))
    with bag:
        transforms = Transforms()
        for topic, message, _ in bag.read_messages(['/tf', '/tf_static', 'tf', 'tf_static']):
            for transform in message.transforms:
                transforms.add(transform, topic.endswith('static'))
        count = bag.get_message_count(points_topic)
        if count == 0:
            raise InputError('{} has no message on {}.'.format(path, points_topic))
        random = np.random.RandomState(1)
        times, scans, places = [], [], []
        for number, (_, message, _) in enumerate(bag.read_messages([points_topic])):
            if number % 100 == 0:
                progress('scan {} of {}'.format(number, count))
            time = message.header.stamp.to_sec()
            size = message.width * message.height
            if size == 0:
                continue
            cells = [
                (int(k % message.width), int(k // message.width))
                for k in random.randint(0, size, _POINTS // count + 1)
            ]
            local = np.array(
                list(point_cloud2.read_points(message, ('x', 'y', 'z'), uvs=cells)), float
            ).reshape(-1, 3)
            local = local[np.all(np.isfinite(local), axis=1)]
            points = transforms.to(target_frame, message.header.frame_id, time, local)
            if points is None:
                continue
            registered = message.header.frame_id.strip('/') == target_frame.strip('/')
            place = np.full((1, 3), np.nan)
            if not registered:
                place = transforms.to(
                    target_frame, message.header.frame_id, time, np.zeros((1, 3))
                )
            times.append(time)
            scans.append(points)
            places.append(place[0])
    if not times:
        raise InputError(
            '{}: no scan of {} can be placed in {}. check_bag says why.'.format(
                path, points_topic, target_frame
            )
        )
    return np.array(times), scans, np.array(places)


def read_reports(folder):
    """[(stamp [s], plant_id, base (3,), height, score)] in the order in which they were reported."""
    path = '{}/journal.sqlite'.format(folder)
    scores = read_table('{}/plants.csv'.format(folder), ('plant_id', 'score'))
    score_of = dict(zip(scores['plant_id'].astype(int), scores['score']))
    try:
        with sqlite3.connect('file:{}?mode=ro'.format(path), uri=True) as database:
            rows = database.execute(
                'SELECT stamp_ns, plant_id, x, y, z, height FROM plant '
                'JOIN report ON report = number ORDER BY number'
            ).fetchall()
    except sqlite3.Error as error:
        raise InputError('Cannot read {}: {}. Give the folder of a live run.'.format(path, error))
    return [
        (stamp * 1e-9, plant, np.array([x, y, z]), np.nan if height is None else height)
        + (score_of.get(plant, np.nan),)
        for stamp, plant, x, y, z, height in rows
        if plant in score_of
    ]


def draw_drive(path, times, scans, places, reports, seconds=5.0, width=640):
    """Writes an animated GIF of `seconds`, or a still picture of the end where `path` ends in .png."""
    along, origin = _long_side(np.vstack(scans))
    reached = [_project(points, along, origin) for points in scans]
    everything = np.vstack(reached)
    low, high = np.percentile(everything, [0.5, 99.5], axis=0) + np.array([[-0.3], [0.3]])
    levels = np.concatenate([points[:, 2] for points in scans])
    colors = LinearSegmentedColormap.from_list('field', _COLORS)(
        np.clip((levels - np.percentile(levels, 5)) / max(np.ptp(levels), 1e-3), 0.0, 1.0)
    )
    aspect = float((high - low)[1] / (high - low)[0])
    figure = plt.figure(figsize=(width / 100.0, width / 100.0 * np.clip(aspect, 0.3, 0.8)), dpi=100)
    figure.patch.set_facecolor(_BACKGROUND)
    axis = figure.add_axes([0.0, 0.0, 1.0, 1.0])
    axis.set_axis_off()
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    cloud = axis.scatter([], [], s=0.6, linewidths=0)
    bars = LineCollection([], linewidths=1.6)
    axis.add_collection(bars)
    rover = axis.plot([], [], 's', color='white', markersize=8)[0]
    words = axis.text(0.01, 0.97, '', color='white', va='top', transform=axis.transAxes, fontsize=9)
    ends = np.cumsum([len(points) for points in reached])

    def draw(now):
        scan = max(int(np.searchsorted(times, now, 'right')) - 1, 0)
        cloud.set_offsets(everything[: ends[scan]])
        cloud.set_facecolor(colors[: ends[scan]])
        known = {}
        for stamp, plant, base, height, score in reports:
            if stamp <= now:
                known[plant] = base, height, score
        lines, tints = [], []
        for base, height, score in known.values():
            top = base + [0.0, 0.0, height if np.isfinite(height) else 0.05]
            lines.append(_project(np.array([base, top]), along, origin))
            good = np.clip(score if np.isfinite(score) else 0.0, 0.0, 1.0)
            tints.append((min(1.0, 2.0 - 2.0 * good), min(1.0, 2.0 * good), 0.1))
        bars.set_segments(lines)
        bars.set_color(tints)
        if np.all(np.isfinite(places[scan])):
            rover.set_data(*_project(places[scan : scan + 1], along, origin).T)
        words.set_text('{:.0f} s   {} plants'.format(now - times[0], len(known)))

    last = max([times[-1]] + [report[0] for report in reports])
    if path.lower().endswith('.png'):
        draw(last)
        figure.savefig(path, facecolor=_BACKGROUND)
    else:
        _write_gif(path, figure, draw, np.linspace(times[0], last, int(seconds * FRAMES_PER_SECOND)))
    plt.close(figure)


def _write_gif(path, figure, draw, moments):
    from PIL import Image

    frames = []
    for moment in moments:
        draw(moment)
        figure.canvas.draw()
        pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]
        frames.append(Image.fromarray(pixels.copy()))
    # One palette for all: the last frame has everything in it.
    palette = frames[-1].quantize(32)
    frames = [frame.quantize(palette=palette, dither=0) for frame in frames]
    durations = [1000 // FRAMES_PER_SECOND] * (len(frames) - 1) + [2000]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=durations, loop=0, optimize=True
    )


def _long_side(points):
    """Unit vector of the longer side of what is seen from above, and its middle."""
    origin = np.median(points, axis=0)
    flat = points[:, :2] - origin[:2]
    _, directions = np.linalg.eigh(flat.T @ flat)
    along = directions[:, 1]
    return along * (1.0 if along[np.argmax(np.abs(along))] > 0.0 else -1.0), origin


def _project(points, along, origin):
    """Seen from the side, a little from above and from the right."""
    away = points - origin
    across = away[:, :2] @ np.array([-along[1], along[0]])
    return np.column_stack(
        [away[:, :2] @ along + _DEPTH[0] * across, away[:, 2] + _DEPTH[1] * across]
    )
