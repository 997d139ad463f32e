#!/usr/bin/env python3
"""Builds examples/measure_points with the installed core, and measures six stems with it.

library_test.py PREFIX           the package is installed there
library_test.py PREFIX --build BUILD  installs the core of a build without ROS there first
"""

import math
import os
import random
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
DIAMETER = 0.022  # [m]
HEIGHT = 1.2


def stems_on_soil():
    """Lines "x y z" of six upright stems at 0.2 m in a row, on level soil, far from the origin."""
    random.seed(1)
    lines = []

    def add(x, y, z):
        noise = [random.gauss(0.0, 0.001) for _ in range(3)]
        lines.append('%.4f %.4f %.4f' % (5e5 + x + noise[0], y + noise[1], 90.0 + z + noise[2]))

    for _ in range(12000):
        add(random.uniform(-0.5, 1.5), random.uniform(-0.5, 0.5), 0.0)
    for stem in range(6):
        for _ in range(1500):
            angle = random.uniform(0.0, 2.0 * math.pi)
            radius = 0.5 * DIAMETER
            add(0.2 * stem + radius * math.cos(angle), radius * math.sin(angle),
                random.uniform(0.0, HEIGHT))
    return '\n'.join(lines)


def main(prefix, build=None):
    if build:
        subprocess.check_call(
            ['cmake', '--install', build, '--prefix', prefix, '--component', 'core'],
            stdout=subprocess.DEVNULL,
        )
    with tempfile.TemporaryDirectory() as folder:
        subprocess.check_call(
            ['cmake', '-S', os.path.join(ROOT, 'examples', 'measure_points'), '-B', folder,
             '-DCMAKE_PREFIX_PATH=' + prefix, '-DCMAKE_BUILD_TYPE=Release']
        )
        subprocess.check_call(['cmake', '--build', folder])
        said = subprocess.check_output(
            [os.path.join(folder, 'measure_points')], input=stems_on_soil(), text=True
        )
    print(said)
    plants = [line.split() for line in said.splitlines()[1:]]
    assert len(plants) == 6, 'six plants stand there'
    for plant in plants:
        assert abs(float(plant[3]) - HEIGHT) < 0.02, 'height of ' + plant[0]
        assert abs(float(plant[5]) - 1e3 * DIAMETER) < 1.0, 'diameter of ' + plant[0]


if __name__ == '__main__':
    main(sys.argv[1], sys.argv[3] if '--build' in sys.argv else None)
