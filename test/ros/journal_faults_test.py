#!/usr/bin/env python3
"""A disk that is full, or read-only, while plants are measured: that is said, measuring goes on, and what
was measured meanwhile is in the journal once it can be written.

Usage: journal_faults_test.py WRITE_TEST_BAG

Needs to mount small file systems; skips, and says so, where that is not allowed.
"""
import os
import signal
import subprocess
import sys
import tempfile
import unittest

from restart_test import free_port, reported, wait_until

DRIVES = 6


def mount(*arguments):
    return subprocess.run(
        ["mount"] + list(arguments), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


class JournalFaultsTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.disk = os.path.join(self.folder.name, "disk")
        os.mkdir(self.disk)
        done = mount("-t", "tmpfs", "-o", "size=4m", "tmpfs", self.disk)
        if done.returncode != 0:
            print("SKIPPED: a file system cannot be mounted here: " + done.stdout)
            self.skipTest(done.stdout)
        self.addCleanup(subprocess.run, ["umount", "--lazy", self.disk], check=True)
        self.bag = os.path.join(self.folder.name, "field.bag")
        self.plants = len(
            subprocess.check_output([WRITE_TEST_BAG, self.bag, str(DRIVES)], text=True).splitlines())
        self.journal = os.path.join(self.disk, "journal.sqlite")
        self.environment = dict(
            os.environ, ROS_MASTER_URI="http://localhost:%d" % free_port(),
            ROS_HOME=os.path.join(self.folder.name, "ros"))
        self.log = open(os.path.join(self.folder.name, "log"), "w+")
        self.addCleanup(self.log.close)

    def start(self, *command):
        process = subprocess.Popen(
            command, env=self.environment, stdout=self.log, stderr=subprocess.STDOUT)

        def end():
            process.send_signal(signal.SIGINT)
            process.wait(60)

        self.addCleanup(end)
        return process

    def start_chain(self):
        port = self.environment["ROS_MASTER_URI"].rsplit(":", 1)[1]
        return self.start(
            "roslaunch", "-p", port, "field_phenotyping", "field_phenotyping.launch",
            "recorder:=false", "output:=" + self.disk)

    def play(self):
        return self.start("rosbag", "play", "--quiet", "--wait-for-subscribers", self.bag)

    def fill_disk(self):
        """The file that takes all that is left."""
        filler = os.path.join(self.disk, "filler")
        try:
            with open(filler, "wb", buffering=0) as file:
                while True:
                    file.write(bytes(4096))
        except OSError:
            pass
        return filler

    def said(self):
        with open(self.log.name) as log:
            return log.read()

    def hears(self, text, seconds=60.0):
        return wait_until(lambda: text in self.said(), seconds)

    def all_are_reported(self):
        return len(set(row[0] for row in reported(self.journal))) >= self.plants

    def test_full_disk_is_named_and_nothing_is_lost(self):
        chain = self.start_chain()
        self.assertTrue(wait_until(lambda: os.path.exists(self.journal), 60.0), self.said())
        filler = self.fill_disk()
        player = self.play()
        self.assertTrue(self.hears("full"), self.said())
        self.assertIn("Measuring goes on; what is measured waits in memory", self.said())
        player.wait(120)
        self.assertFalse(self.all_are_reported())
        self.assertIsNone(chain.poll(), "the launch ended: " + self.said())
        os.remove(filler)
        self.assertTrue(wait_until(self.all_are_reported, 60.0), self.said())

    def test_disk_that_fills_up_while_plants_are_reported_is_named_and_nothing_is_lost(self):
        self.start_chain()
        player = self.play()
        self.assertTrue(wait_until(lambda: len(reported(self.journal)) > 0, 60.0), self.said())
        filler = self.fill_disk()
        self.assertTrue(self.hears("Measuring goes on; what is measured waits in memory"), self.said())
        player.wait(120)
        before = len(reported(self.journal))
        os.remove(filler)
        self.assertTrue(
            wait_until(lambda: len(reported(self.journal)) > before and self.all_are_reported(), 60.0),
            self.said())

    def test_read_only_disk_is_named_and_nothing_is_lost(self):
        self.assertEqual(mount("-o", "remount,ro", self.disk).returncode, 0)
        chain = self.start_chain()
        player = self.play()
        self.assertTrue(self.hears("Measuring goes on"), self.said())
        player.wait(120)
        self.assertIsNone(chain.poll(), "the launch ended: " + self.said())
        self.assertEqual(mount("-o", "remount,rw", self.disk).returncode, 0)
        self.assertTrue(wait_until(self.all_are_reported, 60.0), self.said())


if __name__ == "__main__":
    WRITE_TEST_BAG = sys.argv.pop(1)
    unittest.main()
