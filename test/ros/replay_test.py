#!/usr/bin/env python3
"""Replays a short bag through replay.launch and compares plants.csv with the truth."""
import csv
import json
import math
import os
import re
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
import unittest

import rosbag
import rospy
from PIL import Image
from sensor_msgs.msg import PointCloud2


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def replay(folder, *arguments):
    """Runs replay.launch with a master of its own; returns its exit code, its words, the plants."""
    port = free_port()
    environment = dict(
        os.environ, ROS_HOME=os.path.join(folder, "ros"),
        ROS_MASTER_URI="http://localhost:%d" % port)
    output = os.path.join(folder, "out")
    run = subprocess.run(
        ["roslaunch", "-p", str(port), "field_phenotyping", "replay.launch", "output:=" + output]
        + list(arguments),
        env=environment, timeout=90, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    with open(os.path.join(output, "plants.csv")) as table:
        plants = list(csv.DictReader(table))
    with open(os.path.join(output, "plants.geojson")) as collection:
        features = json.load(collection)["features"]
    assert len(features) == len(plants)
    return run.returncode, run.stdout, plants


def make_bag(folder, drives=1):
    """Writes a bag of six plants; returns its path and the plants' bases."""
    bag = os.path.join(folder, "field.bag")
    said = subprocess.check_output([WRITE_TEST_BAG, bag, str(drives)], text=True)
    return bag, [[float(v) for v in line.split()] for line in said.splitlines()]


class ReplayTest(unittest.TestCase):
    def test_bag_in_plants_out(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            code, said, plants = replay(folder, "bag:=" + bag)
            with sqlite3.connect(os.path.join(folder, "out", "journal.sqlite")) as journal:
                reports = journal.execute("SELECT block_x, block_y FROM report").fetchall()
        self.assertEqual(code, 0, said)
        self.assertEqual(len(reports), len(set(reports)), "each block is worked once")
        self.assertRegex(said, r"30 scans, in \S+ s, \S+ x real time: all is worked")
        self.assertNotIn("WARN", said)
        self.assertEqual(len(plants), len(truth), said)
        for x, y, _ in truth:
            distances = [math.hypot(float(p["x"]) - x, float(p["y"]) - y) for p in plants]
            self.assertLess(min(distances), 0.04)
            nearest = plants[distances.index(min(distances))]
            self.assertAlmostEqual(float(nearest["height"]), 1.3, delta=0.05)
            self.assertAlmostEqual(float(nearest["stem_diameter"]), 0.022, delta=0.003)
            self.assertEqual(nearest["final"], "1")

    def test_split_bags_in_plants_out(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            with rosbag.Bag(bag) as whole:
                parts = [rosbag.Bag(os.path.join(folder, "part_%d.bag" % k), "w") for k in (0, 1)]
                half = (whole.get_start_time() + whole.get_end_time()) / 2
                for topic, message, stamp in whole.read_messages():
                    parts[stamp.to_sec() > half].write(topic, message, stamp)
            for part in parts:
                part.close()
            code, said, plants = replay(folder, "bag:=" + os.path.join(folder, "part_*.bag"))
        self.assertEqual(code, 0, said)
        self.assertRegex(said, r"30 scans, in \S+ s, \S+ x real time: all is worked")
        self.assertEqual(len(plants), len(truth), said)

    def test_wrong_parameters_are_named_with_what_is_right(self):
        config = os.path.join(os.path.dirname(os.path.abspath(__file__)), "wrong_parameters.yaml")
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            code, said, plants = replay(folder, "bag:=" + bag, "config:=" + config)
        self.assertEqual(code, 0, said)
        self.assertEqual(len(plants), len(truth), said)
        for text in (
                "preprocessing/voxelsize'; did you mean 'preprocessing/voxel_size' "
                "(0.0005 ... 0.1 m)?",
                "preprocessing/tf_timout'; did you mean 'preprocessing/tf_timeout'",
                "preprocessing/outlier_radius is not a number (0.001 ... 1 m): ignored",
                "preprocessing/tf_timeout is not a number (0 ... s): ignored",
                "preprocessing/queue_size is 0, below 1: taken for that",
                "segmentation/M_branching is 7, outside 0.1 ... 2: moved into it",
                "segmentation/block_size'; did you mean 'preprocessing/block_size' (0.5 ... 100 m)?",
                "segmentaton/M is read by nobody: there is no stage 'segmentaton'; did you mean "
                "'segmentation'?",
                "'papr' is neither 'robust' nor 'paper'; did you mean 'paper'?"):
            self.assertIn(text, said)

    def test_bag_without_points_names_what_is_there(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, _ = make_bag(folder)
            code, said, plants = replay(folder, "bag:=" + bag, "points_topic:=/scan")
            self.assertIn("no sensor_msgs/PointCloud2 on /scan, only:", said)
            self.assertIn("/points (sensor_msgs/PointCloud2)", said)
            self.assertEqual(plants, [])
            code, said, plants = replay(folder, "bag:=" + os.path.join(folder, "none.bag"))
            self.assertIn("none.bag' cannot be read", said)

    def test_other_clouds_of_a_bag_are_named(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            with rosbag.Bag(bag, "a") as more:
                more.write("/rear/points", PointCloud2(), rospy.Time(1600000001))
            code, said, plants = replay(folder, "bag:=" + bag)
        self.assertIn("only /points is played; the bag has other clouds too: /rear/points", said)
        self.assertEqual(len(plants), len(truth), said)

    def test_no_scan_is_dropped_though_there_are_more_than_the_queue_holds(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder, drives=14)
            code, said, plants = replay(folder, "bag:=" + bag)
        self.assertEqual(len(plants), len(truth), said)
        speed = re.search(r"420 scans, in \S+ s, (\S+) x real time: all is worked", said)
        self.assertTrue(speed, said)
        self.assertGreater(float(speed.group(1)), 1.0, said)
        self.assertNotIn("dropped", said)

    def test_played_again_and_again_time_and_place_go_on(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            # The rover stands still at the end, and at the beginning of the next time.
            code, said, plants = replay(
                folder, "bag:=" + bag, "loops:=3", "loop_period:=3.0", "loop_step_x:=3.6")
        self.assertEqual(code, 0, said)
        self.assertRegex(said, r"8\.9 of 8\.9 s, 90 scans, in \S+ s, \S+ x real time: all is worked")
        self.assertNotIn("time went back", said)
        self.assertEqual(len(plants), 3 * len(truth), said)
        for loop in range(3):
            for x, y, _ in truth:
                distances = [
                    math.hypot(float(p["x"]) - x - 3.6 * loop, float(p["y"]) - y) for p in plants]
                self.assertLess(min(distances), 0.04)

    def test_played_again_at_the_same_time_each_scan_is_placed(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            code, said, plants = replay(folder, "bag:=" + bag, "loops:=3")
        self.assertEqual(code, 0, said)
        self.assertIn("time went back", said)
        self.assertIn("transforms of 'lidar' went back", said)
        self.assertNotIn("dropped", said)
        self.assertEqual(len(plants), len(truth), said)

    def test_tiles_that_adjoin_are_worked_as_one(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            code, said, plants = replay(
                folder, "bag:=" + bag, "loops:=12", "loop_period:=3.0", "loop_step_x:=3.6")
            with sqlite3.connect(os.path.join(folder, "out", "journal.sqlite")) as journal:
                # Tiles that were worked as one bear the same stamp.
                together = [count for count, in journal.execute(
                    "SELECT COUNT(*) FROM report GROUP BY stamp_ns ORDER BY stamp_ns")]
        self.assertEqual(code, 0, said)
        self.assertEqual(len(plants), 12 * len(truth), said)
        self.assertGreater(len(together), 1, "not all of them at the end")
        self.assertGreaterEqual(min(together[:-1]), 4, together)

    def test_no_faster_than_asked_for(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder)
            begin = time.monotonic()
            code, said, plants = replay(folder, "bag:=" + bag, "rate:=1.0")
            self.assertGreater(time.monotonic() - begin, 2.9 + 3.0, said)
            picture = os.path.join(folder, "drive.gif")
            subprocess.check_call(
                ["rosrun", "field_phenotyping", "draw_drive", bag, os.path.join(folder, "out"),
                 "--output", picture, "--seconds", "2"])
            self.assertLess(os.path.getsize(picture), 1000000)
            with Image.open(picture) as frames:
                self.assertEqual(frames.n_frames, 16)
                self.assertEqual(frames.size[0], 640)
                first = frames.convert("RGB").tobytes()
                frames.seek(15)
                self.assertNotEqual(frames.convert("RGB").tobytes(), first)
        self.assertEqual(len(plants), len(truth), said)

    def test_at_a_rate_what_cannot_be_worked_is_dropped_as_on_a_rover(self):
        with tempfile.TemporaryDirectory() as folder:
            bag, truth = make_bag(folder, drives=14)
            code, said, plants = replay(folder, "bag:=" + bag, "rate:=1000.0")
        self.assertEqual(code, 0, said)
        speed = re.search(r"420 scans, in \S+ s, (\S+) x real time: all scans are placed", said)
        self.assertTrue(speed, said)
        self.assertGreater(float(speed.group(1)), 20.0, said)
        self.assertIn("scans arrive faster than they are worked", said)
        self.assertEqual(len(plants), len(truth), said)

    def test_foreign_bag_of_a_road_gives_no_plant_and_says_why(self):
        bag = os.path.join(SHARED_DATA, "luminar.bag")
        if not os.path.exists(bag):
            self.skipTest(bag + " is not there")
        with tempfile.TemporaryDirectory() as folder:
            code, said, plants = replay(
                folder, "bag:=" + bag, "points_topic:=/luminar_pointcloud",
                "target_frame:=luminar_lidar")
        self.assertEqual(code, 0, said)
        confident = [p for p in plants if "low_confidence" not in p["quality"]]
        self.assertEqual(confident, [], said)
        self.assertIn("no plant found in", said)


if __name__ == "__main__":
    WRITE_TEST_BAG, SHARED_DATA = sys.argv.pop(1), sys.argv.pop(1)
    unittest.main()
