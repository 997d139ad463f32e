#!/usr/bin/env python3
"""Checks that README.md says what the programs do: parameters, columns and flags.

readme_test.py PHENOTYPE_CLOUD            compares
readme_test.py PHENOTYPE_CLOUD --update   writes the parameter tables anew
"""

import os
import re
import subprocess
import sys
import tempfile
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
README = os.path.join(ROOT, 'README.md')
STAGES = ('preprocessing', 'segmentation', 'completion', 'measurement')
HEADER = '| Parameter | Type | Default | Range | Meaning |\n|---|---|---|---|---|\n'


def read(*path):
    with open(os.path.join(ROOT, *path)) as file:
        return file.read()


def types(stage):
    """Type of each parameter, which --list-parameters does not tell, from its .cfg file."""
    rows = re.findall(r'\("(\w+)",\s*(\w+)_t,', read('cfg', stage.capitalize() + '.cfg'))
    return {name: {'str': 'string'}.get(kind, kind) for name, kind in rows}


def parameter_table(stage, listing):
    """The README's table of a stage, made from the output of --list-parameters."""
    pattern = r'^{}/(\w+) = (\S+) ?(.*?)  \[(\S+) \.\.\. (\S+)\]\n    (.*)$'.format(stage)
    rows = []
    for name, default, unit, low, high, meaning in re.findall(pattern, listing, re.MULTILINE):
        span = '{}, {}'.format(low, high)
        if types(stage)[name] in ('double', 'int'):
            span = '{} ... {}'.format(low, high) + (' ' + unit if unit else '')
        default += ' ' + unit if unit else ''
        rows.append(
            '| `{}` | {} | {} | {} | {} |\n'.format(name, types(stage)[name], default, span, meaning)
        )
    return HEADER + ''.join(rows)


def section(stage):
    """What stands between the marks of a stage's parameter table."""
    return re.compile(
        r'(<!-- parameters: {} -->\n)(.*?)(<!-- end -->)'.format(stage), re.DOTALL
    )


def listing():
    return subprocess.check_output([PHENOTYPE_CLOUD, '--list-parameters'], text=True)


def update():
    text = read('README.md')
    for stage in STAGES:
        table = parameter_table(stage, listing())
        text = section(stage).sub(lambda found: found[1] + table + found[3], text)
    with open(README, 'w') as file:
        file.write(text)


def anchors(text):
    """What links into a page may name: its headings as GitHub spells them, and names given in it."""
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    spelled = [re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings]
    return spelled + re.findall(r'<a name="([^"]+)">', text)


class ReadmeTest(unittest.TestCase):
    def test_parameter_tables_are_those_of_list_parameters(self):
        said = listing()
        for stage in STAGES:
            found = section(stage).search(read('README.md'))
            self.assertIsNotNone(found, 'no table of the parameters of ' + stage)
            self.assertEqual(found[2], parameter_table(stage, said), 'run this with --update')
            self.assertGreater(found[2].count('\n'), 5)

    def test_every_column_is_explained(self):
        text = read('README.md')
        stand = text.split('### rows.csv and canopy.csv')[1].split('\n#')[0]
        growth = text.split('### What the segmenter decided')[1].split('\n#')[0]
        plants, regions = growth.split('`growth_regions.csv` one row a region')
        tables = {
            'plants.csv': text.split('### plants.csv')[1].split('\n#')[0],
            'rows.csv': stand.split('`canopy.csv` has one row')[0],
            'canopy.csv': stand.split('`canopy.csv` has one row')[1],
            'growth.csv': plants,
            'growth_regions.csv': regions,
        }
        with tempfile.TemporaryDirectory() as folder:
            cloud = os.path.join(folder, 'cloud.pcd')
            with open(cloud, 'w') as file:
                file.write(
                    'VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\n'
                    'HEIGHT 1\nPOINTS 4\nDATA ascii\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n'
                )
            subprocess.check_output([PHENOTYPE_CLOUD, cloud, '--output', folder, '--debug'])
            for name, said in tables.items():
                with open(os.path.join(folder, name)) as table:
                    columns = table.readline().strip().split(',')
                first_cells = re.findall(r'^\| (`.*?) \|', said, re.MULTILINE)
                explained = [word for cell in first_cells for word in re.findall(r'`(\w+)`', cell)]
                self.assertEqual(sorted(columns), sorted(explained), name)

    def assert_flags_explained(self, constants, section):
        """Each constant of PlantPhenotype.msg that the pattern finds is in the section's table."""
        flags = re.findall(constants, read('msg', 'PlantPhenotype.msg'), re.MULTILINE)
        table = read('README.md').split('### ' + section)[1].split('\n#')[0]
        explained = re.findall(r'^\| `(\w+)` \| (\d+) \|', table, re.MULTILINE)
        self.assertEqual([(name.lower(), bit) for name, bit in flags if bit != '0'], explained)

    def test_every_quality_flag_is_explained(self):
        self.assert_flags_explained(r'^uint32 (\w+) = (\d+)', 'Quality flags')

    def test_every_completion_flag_is_explained(self):
        self.assert_flags_explained(r'^uint8 COMPLETION_(\w+) = (\d+)', 'Completion flags')

    def test_links_lead_somewhere(self):
        for page in ('README.md', 'docs/accuracy.md', 'docs/performance.md'):
            links = re.findall(r'\]\((?!http)([^)#]*)(?:#([^)]*))?\)', read(page))
            self.assertTrue(links, page)
            for file, anchor in links:
                target = os.path.join(ROOT, os.path.dirname(page), file) if file else page
                self.assertTrue(os.path.exists(os.path.join(ROOT, target)), page + ': ' + file)
                if anchor:
                    self.assertIn(anchor, anchors(read(target)), page + ': ' + file)


if __name__ == '__main__':
    PHENOTYPE_CLOUD = sys.argv.pop(1)
    update() if '--update' in sys.argv else unittest.main()
