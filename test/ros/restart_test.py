#!/usr/bin/env python3
"""Kills the nodelet manager again and again while a bag is replayed: no plant may be lost or renamed.

Usage: restart_test.py WRITE_TEST_BAG [KILLS]
"""
import collections
import csv
import math
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
import unittest

KILLS = 4


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def manager_pid(master):
    """The process of the nodelet manager at that master, or None."""
    for pid in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open("/proc/%s/cmdline" % pid, "rb") as command, \
                    open("/proc/%s/environ" % pid, "rb") as environment:
                words = command.read().split(b"\0")
                uri = [v for v in environment.read().split(b"\0") if v.startswith(b"ROS_MASTER_URI=")]
                port = master.rsplit(":", 1)[1].encode()
                if b"__name:=manager" in words and uri and port in uri[0]:
                    return int(pid)
        except OSError:
            pass
    return None


def reported(journal):
    """(plant_id, x, y) of every report so far."""
    if not os.path.exists(journal):
        return []
    with sqlite3.connect(journal, timeout=10.0) as database:
        try:
            return database.execute("SELECT plant_id, x, y FROM plant").fetchall()
        except sqlite3.OperationalError:  # not set up yet
            return []


def wait_until(condition, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.1)
    return False


class RestartTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.bag = os.path.join(self.folder.name, "field.bag")
        self.truth = [
            [float(v) for v in line.split()] for line in
            subprocess.check_output([WRITE_TEST_BAG, self.bag, str(2 * KILLS + 4)], text=True)
            .splitlines()
        ]
        self.journal = os.path.join(self.folder.name, "out", "journal.sqlite")
        self.master = "http://localhost:%d" % free_port()
        environment = dict(
            os.environ, ROS_MASTER_URI=self.master, ROS_HOME=os.path.join(self.folder.name, "ros"))
        self.log = open(os.path.join(self.folder.name, "log"), "w+")
        self.processes = []
        for command in (
                ["roslaunch", "-p", self.master.rsplit(":", 1)[1], "field_phenotyping",
                 "field_phenotyping.launch", "respawn:=true", "new_journal:=true",
                 "output:=" + os.path.dirname(self.journal)],
                ["rosbag", "play", "--quiet", "--wait-for-subscribers", self.bag]):
            self.processes.append(subprocess.Popen(
                command, env=environment, stdout=self.log, stderr=subprocess.STDOUT))
            self.assertTrue(wait_until(lambda: manager_pid(self.master), 60.0), self.said())

    def tearDown(self):
        for process in reversed(self.processes):
            process.send_signal(signal.SIGINT)
        for process in reversed(self.processes):
            process.wait(60)
        self.log.close()
        self.folder.cleanup()

    def said(self):
        self.log.seek(0)
        return self.log.read()

    def test_plants_keep_their_ids(self):
        chance = random.Random(5)
        for kill in range(KILLS):
            print("%d of %d" % (kill, KILLS), flush=True)
            # Often before everything is up again, often in the middle of the work.
            self.assertTrue(wait_until(lambda: manager_pid(self.master), 60.0), self.said())
            if chance.random() < 0.7:
                now = len(reported(self.journal))
                wait_until(lambda: len(reported(self.journal)) > now, 10.0)
            time.sleep(chance.uniform(0.0, 1.5))
            before = reported(self.journal)
            victim = manager_pid(self.master)
            self.assertIsNotNone(victim, "it died by itself: " + self.said()[-3000:])
            os.kill(victim, signal.SIGKILL)
            self.assertEqual(reported(self.journal)[:len(before)], before)
        now = len(reported(self.journal))
        self.assertTrue(wait_until(lambda: len(reported(self.journal)) > now, 60.0), self.said())
        self.processes[-1].wait(600)
        time.sleep(5.0)  # the last blocks are final
        self.assertEqual(reported(self.journal)[:len(before)], before, "the journal was begun anew")
        ids = collections.defaultdict(set)
        for plant_id, x, y in reported(self.journal):
            offs = [math.hypot(x - t[0], y - t[1]) for t in self.truth]
            # Further off: a leaf that was taken for a plant when little had been seen.
            if min(offs) < 0.1:
                ids[offs.index(min(offs))].add(plant_id)
        self.assertEqual(len(ids), len(self.truth), "plants were lost")
        self.assertTrue(all(len(names) == 1 for names in ids.values()), dict(ids))
        self.assertEqual(len(set.union(*ids.values())), len(self.truth), dict(ids))

        def believed():
            with open(os.path.join(os.path.dirname(self.journal), "plants.csv")) as table:
                return set(int(plant["plant_id"]) for plant in csv.DictReader(table))

        self.assertTrue(
            wait_until(lambda: believed() == set.union(*ids.values()), 30.0), believed())


if __name__ == "__main__":
    WRITE_TEST_BAG = sys.argv.pop(1)
    if len(sys.argv) > 1 and sys.argv[1].isdigit():
        KILLS = int(sys.argv.pop(1))
    unittest.main()
