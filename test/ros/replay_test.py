#!/usr/bin/env python3
"""Replays a short bag through replay.launch and compares plants.csv with the truth."""
import csv
import json
import math
import os
import socket
import subprocess
import sys
import tempfile
import unittest


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


class ReplayTest(unittest.TestCase):
    def test_bag_in_plants_out(self):
        with tempfile.TemporaryDirectory() as folder:
            bag = os.path.join(folder, "field.bag")
            truth = [
                [float(v) for v in line.split()]
                for line in subprocess.check_output([WRITE_TEST_BAG, bag], text=True).splitlines()
            ]
            code, said, plants = replay(folder, "bag:=" + bag)
        self.assertEqual(code, 0, said)
        self.assertEqual(len(plants), len(truth), said)
        for x, y, _ in truth:
            distances = [math.hypot(float(p["x"]) - x, float(p["y"]) - y) for p in plants]
            self.assertLess(min(distances), 0.04)
            nearest = plants[distances.index(min(distances))]
            self.assertAlmostEqual(float(nearest["height"]), 1.3, delta=0.05)
            self.assertAlmostEqual(float(nearest["stem_diameter"]), 0.022, delta=0.003)
            self.assertEqual(nearest["final"], "1")

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
