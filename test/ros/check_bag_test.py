#!/usr/bin/env python3
"""check_bag on a bag that is well, and on copies of it with one fault each."""
import copy
import json
import os
import subprocess
import sys
import tempfile
import unittest

import numpy
import rosbag
import rospy
from geometry_msgs.msg import Quaternion


def coordinates(message):
    """The x, y, z of every point, as an array that can be written to."""
    points = numpy.frombuffer(message.data, "u1").reshape(-1, message.point_step).copy()
    return points, points[:, :12].view("f4")


def with_coordinates(change):
    """A fault that changes the coordinates of each scan: change(xyz, random)."""
    def apply(messages):
        random = numpy.random.RandomState(1)
        for topic, message, _ in messages:
            if topic != "/points":
                continue
            points, xyz = coordinates(message)
            change(xyz, random)
            message.data = points.tobytes()
        return messages
    return apply


def each(wanted_topic, change):
    """A fault that changes each message of a topic: change(index, message, time) gives the new
    (message, time), or None to leave it out."""
    def apply(messages):
        result = []
        index = 0
        for topic, message, time in messages:
            if topic == wanted_topic:
                changed = change(index, message, time)
                index += 1
                if changed is None:
                    continue
                message, time = changed
            result.append((topic, message, time))
        return result
    return apply


def edit(attribute_path, value):
    """Sets an attribute of a message, for each()."""
    def change(index, message, time):
        owner = message
        *path, last = attribute_path.split(".")
        for name in path:
            owner = owner[int(name)] if name.isdigit() else getattr(owner, name)
        setattr(owner, last, value(index, getattr(owner, last)) if callable(value) else value)
        return message, time
    return change


def thinned(step):
    """Every step-th point; 0: none."""
    def change(index, message, time):
        points, _ = coordinates(message)
        points = points[index % step::step] if step else points[:0]
        message.data = points.tobytes()
        message.width = len(points)
        message.row_step = message.width * message.point_step
        return message, time
    return change


def misses(xyz, random):
    xyz[random.rand(len(xyz)) < 0.92] = numpy.nan


def zeros(xyz, random):
    xyz[random.rand(len(xyz)) < 0.2] = 0.0


def millimetres(xyz, random):
    xyz *= 1000.0


def flat(xyz, random):
    xyz[:, 2] = -1.0


def level_and_flat(messages):
    """Bare soil: every point at one height under a sensor that is level."""
    level = each("/tf", edit("transforms.0.transform.rotation", Quaternion(0.0, 0.0, 0.0, 1.0)))
    return with_coordinates(flat)(level(messages))


def far(xyz, random):
    xyz[:, 0] += 448262.0


SECOND = rospy.Duration(1)
# name: (fault, arguments, exit status, severity, what it is about, what is said or advised)
FAULTS = {
    "no points": (each("/points", lambda *_: None), (), 2, "error", "topics", "only: /tf"),
    "other topic": (None, ("--points-topic", "/pionts"), 2, "error", "topics",
                    "points_topic:=/points"),
    "topic of another type": (None, ("--points-topic", "/tf"), 2, "error", "topics",
                              "tf2_msgs/TFMessage"),
    "no tf": (each("/tf", lambda *_: None), (), 2, "error", "tf", "target_frame:=lidar"),
    "other target frame": (None, ("--target-frame", "odom"), 2, "error", "tf", "target_frame:=map"),
    "not joined": (each("/tf", edit("transforms.0.child_frame_id", "laser")), (), 2, "error", "tf",
                   "no transform leads from 'lidar' to 'map'"),
    "gap in tf": (each("/tf", lambda i, m, t: None if 10 <= i < 15 else (m, t)), (), 1, "warning",
                  "tf", "gap of 0.6 s, 0.9 s after"),
    "tf begins late": (each("/tf", lambda i, m, t: None if i < 5 else (m, t)), (), 1, "warning",
                       "tf", "5 of 30 scans have no transform at their stamp: 5 before"),
    "tf of another clock": (
        each("/tf", edit("transforms.0.header.stamp", lambda i, s: s + 1000 * SECOND)), (), 2,
        "error", "tf", "30 before the first one"),
    "late tf": (each("/tf", lambda i, m, t: (m, t + 3 * SECOND)), (), 1, "warning", "tf",
                "tf_timeout"),
    "two parents": (
        each("/tf", edit("transforms.0.header.frame_id", lambda i, f: "odom" if i == 9 else f)), (),
        1, "warning", "tf", "several parents: map and odom"),
    "broken quaternion": (
        each("/tf", edit("transforms.0.transform.rotation.w", lambda i, w: 0.0 if i == 9 else w)),
        (), 1, "warning", "tf", "1 transforms are invalid"),
    "time goes back": (
        each("/points", edit("header.stamp", lambda i, s: s - SECOND if i == 20 else s)), (), 1,
        "warning", "time", "go back 1 times"),
    "no stamps": (each("/points", edit("header.stamp", rospy.Time())), (), 2, "error", "time",
                  "30 of 30 scans have no stamp"),
    "other clock": (each("/points", lambda i, m, t: (m, t + 100 * SECOND)), (), 1, "warning",
                    "time", "100 s after their stamps"),
    "hole": (each("/points", lambda i, m, t: None if 10 <= i < 20 else (m, t)), (), 1, "warning",
             "time", "1 holes of 1.1 s"),
    "misses": (with_coordinates(misses), (), 1, "warning", "points", "are not finite"),
    "zeros": (with_coordinates(zeros), (), 1, "warning", "points", "are (0, 0, 0)"),
    "millimetres": (with_coordinates(millimetres), (), 2, "error", "points", "in metres?"),
    "empty scans": (each("/points", thinned(0)), (), 2, "error", "points", "hold no point"),
    "unreadable": (each("/points", edit("fields.0.name", "range")), (), 2, "error", "fields",
                   "no field 'x', only: range"),
    "cut short": (each("/points", edit("data", lambda i, d: d[:-1])), (), 2, "error", "fields",
                  "it was cut short"),
    "coarse": (with_coordinates(far), ("--target-frame", "lidar"), None, "warning", "fields",
               "steps of 0.03125 m"),
    "two frames": (each("/points", edit("header.frame_id", lambda i, f: "map" if i == 3 else f)),
                   (), 1, "warning", "frames", "several frames"),
    "no frame": (each("/points", edit("header.frame_id", "")), (), 2, "error", "frames",
                 "no frame_id"),
    "sparse": (each("/points", thinned(400)), (), 2, "error", "density", "a diameter needs"),
    "nothing grows": (level_and_flat, (), 2, "error", "density", "nothing is higher"),
}


class CheckBagTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.bag = os.path.join(cls.folder.name, "good.bag")
        subprocess.check_call([WRITE_TEST_BAG, cls.bag], stdout=subprocess.DEVNULL)
        with rosbag.Bag(cls.bag) as bag:
            cls.messages = list(bag.read_messages())

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def check(self, *arguments):
        done = subprocess.run(
            [CHECK_BAG] + list(arguments), text=True, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE)
        return done.returncode, done.stdout, done.stderr

    def test_good_bag(self):
        status, said, _ = self.check(self.bag)
        self.assertEqual(status, 0, said)
        self.assertIn("nothing wrong was found", said)
        status, said, _ = self.check(self.bag, "--json")
        report = json.loads(said)
        self.assertEqual((status, report["status"], report["findings"]), (0, 0, []))
        self.assertEqual((report["scans"], report["scans_placed"]), (30, 30))
        self.assertEqual(report["tf_chain"], ["lidar", "map"])
        self.assertAlmostEqual(report["rate_hz"], 10.0, delta=0.1)
        self.assertAlmostEqual(report["longest_tf_gap_s"], 0.1, delta=0.01)
        self.assertAlmostEqual(report["latest_tf_s"], 0.2, delta=0.01)
        self.assertAlmostEqual(report["plant_height_m"], 1.3, delta=0.2)
        self.assertEqual(report["soil_share"], 1.0)

    def test_faults_are_named(self):
        for name, (fault, arguments, status, severity, about, text) in FAULTS.items():
            with self.subTest(name):
                bag = self.bag
                if fault:
                    bag = os.path.join(self.folder.name, "faulty.bag")
                    with rosbag.Bag(bag, "w") as out:
                        for topic, message, time in fault(copy.deepcopy(self.messages)):
                            out.write(topic, message, time)
                found, said, error = self.check(bag, "--json", *arguments)
                report = json.loads(said)
                if status is not None:
                    self.assertEqual(found, status, said)
                self.assertEqual(found, report["status"])
                fitting = [
                    f for f in report["findings"] if (f["severity"], f["about"]) ==
                    (severity, about) and text in f["what"] + " " + f["cure"]]
                self.assertEqual(len(fitting), 1, said)
                self.assertTrue(fitting[0]["cure"])
                # People read the same.
                self.assertIn(fitting[0]["what"], self.check(bag, *arguments)[1])

    def test_no_bag(self):
        path = os.path.join(self.folder.name, "none.bag")
        status, _, error = self.check(path)
        self.assertEqual(status, 2)
        self.assertIn("there is no such file", error)
        with open(self.bag, "rb") as whole:
            cut = whole.read()[:20000]
        for content, text in (
                (b"this is no bag\n", "it is no ROS 1 bag"), (b"", "it is empty"),
                (b"SQLite format 3\0", "rosbags-convert"), (b"\x89MCAP0\r\n", "rosbags-convert"),
                (cut, "recording was cut off")):
            with open(path, "wb") as file:
                file.write(content)
            status, _, error = self.check(path)
            self.assertEqual(status, 2)
            self.assertIn(text, error)

    def test_a_bag_that_was_cut_off_can_be_saved_as_it_says(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "field.bag.active")
            with open(self.bag, "rb") as whole, open(path, "wb") as cut:
                cut.write(whole.read()[:-200000])
            _, _, error = self.check(folder)
            self.assertIn("rosbag reindex FILE.bag.active", error)
            _, _, error = self.check(path)
            self.assertIn("rosbag reindex " + path + "` keeps what is in it; then rename", error)
            subprocess.check_call(["rosbag", "reindex", "-q", path], stdout=subprocess.DEVNULL)
            os.rename(path, os.path.join(folder, "field.bag"))
            status, said, error = self.check(folder, "--json")
            self.assertLess(status, 2, said + error)
            self.assertGreater(json.loads(said)["scans"], 20)

    def test_split_bags_are_read_as_one(self):
        with tempfile.TemporaryDirectory() as folder:
            paths = [os.path.join(folder, "drive_%d.bag" % part) for part in (9, 10)]
            bags = [rosbag.Bag(path, "w", compression=compression)
                    for path, compression in zip(paths, ("lz4", "bz2"))]
            half = self.messages[len(self.messages) // 2][2]
            for topic, message, time in self.messages:
                bags[time >= half].write(topic, message, time)
            for bag in bags:
                bag.close()
            # As rosbag compress leaves it: the same messages again.
            os.link(paths[0], os.path.join(folder, "drive_9.orig.bag"))
            for given in (paths, [folder], [os.path.join(folder, "drive_*.bag")], [" ".join(paths)]):
                status, said, error = self.check(*given, "--json")
                self.assertEqual(status, 0, said + error)
                self.assertEqual(json.loads(said)["scans_placed"], 30)
            status, _, error = self.check(paths[0], os.path.join(folder, "drive_11.bag"))
            self.assertEqual(status, 2)
            self.assertIn(os.path.join(folder, "drive_11.bag") + "' cannot be read", error)

    def test_of_two_lidars_it_says_which_it_looks_at(self):
        path = os.path.join(self.folder.name, "two.bag")
        with rosbag.Bag(path, "w") as bag:
            for topic, message, time in self.messages:
                bag.write(topic, message, time)
            for topic, message, time in self.messages[:6]:
                if topic == "/points":
                    bag.write("/rear/points", message, time)
        status, said, _ = self.check(path)
        self.assertEqual(status, 1)
        self.assertIn("/points was checked, not /rear/points", said)
        self.assertEqual(self.check(path, "--points-topic", "/points")[0], 0)

    def test_parameters_count(self):
        status, said, _ = self.check(self.bag, "--set", "preprocessing/max_range=0.5")
        self.assertEqual(status, 2)
        self.assertIn("max_range", said)
        status, _, error = self.check(self.bag, "--set", "preprocessing/maxrange=0.5")
        self.assertEqual(status, 2)
        self.assertIn("did you mean 'preprocessing/max_range'", error)


if __name__ == "__main__":
    CHECK_BAG, WRITE_TEST_BAG = sys.argv.pop(1), sys.argv.pop(1)
    unittest.main()
