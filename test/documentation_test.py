#!/usr/bin/env python3
"""Checks that README.md and docs/ say what the code does.

documentation_test.py PHENOTYPE_CLOUD            compares
documentation_test.py PHENOTYPE_CLOUD --update   writes the parameter tables anew
"""

import csv
import glob
import os
import re
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
NODELETS = 'docs/nodelets.md'
OUTPUT = 'docs/output.md'
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
    """The documented table of a stage, made from the output of --list-parameters."""
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
    text = read(NODELETS)
    for stage in STAGES:
        table = parameter_table(stage, listing())
        text = section(stage).sub(lambda found: found[1] + table + found[3], text)
    with open(os.path.join(ROOT, NODELETS), 'w') as file:
        file.write(text)


def anchors(text):
    """What links into a page may name: its headings as GitHub spells them, and names given in it."""
    headings = re.findall(r'^#+ (.*)$', text, re.MULTILINE)
    spelled = [re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings]
    return spelled + re.findall(r'<a name="([^"]+)">', text)


def pages():
    return ['README.md'] + sorted(
        os.path.relpath(page, ROOT) for page in glob.glob(os.path.join(ROOT, 'docs', '*.md'))
    )


def part(page, heading):
    """What stands under a heading of the second level."""
    return read(page).split('\n## ' + heading + '\n')[1].split('\n## ')[0]


def first_cells(text):
    """Names in the first column of the tables in a text."""
    cells = re.findall(r'^\| (`.*?) \|', text, re.MULTILINE)
    return [word for cell in cells for word in re.findall(r'`(\w+)`', cell)]


class DocumentationTest(unittest.TestCase):
    def test_parameter_tables_are_those_of_list_parameters(self):
        said = listing()
        for stage in STAGES:
            found = section(stage).search(read(NODELETS))
            self.assertIsNotNone(found, 'no table of the parameters of ' + stage)
            self.assertEqual(found[2], parameter_table(stage, said), 'run this with --update')
            self.assertGreater(found[2].count('\n'), 5)

    def test_every_column_is_explained(self):
        stand = part(OUTPUT, 'rows.csv and canopy.csv')
        plants, regions = part(OUTPUT, 'What the segmenter decided').split(
            '`growth_regions.csv` one row a region'
        )
        tables = {
            'plants.csv': part(OUTPUT, 'plants.csv'),
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
                self.assertEqual(sorted(columns), sorted(first_cells(said)), name)

    def assert_flags_explained(self, constants, section):
        """Each constant of PlantPhenotype.msg that the pattern finds is in the section's table."""
        flags = re.findall(constants, read('msg', 'PlantPhenotype.msg'), re.MULTILINE)
        table = part(OUTPUT, section)
        explained = re.findall(r'^\| `(\w+)` \| (\d+) \|', table, re.MULTILINE)
        self.assertEqual([(name.lower(), bit) for name, bit in flags if bit != '0'], explained)

    def test_every_quality_flag_is_explained(self):
        self.assert_flags_explained(r'^uint32 (\w+) = (\d+)', 'Quality flags')

    def test_every_completion_flag_is_explained(self):
        self.assert_flags_explained(r'^uint8 COMPLETION_(\w+) = (\d+)', 'Completion flags')

    def test_the_filter_of_the_readme_keeps_what_it_should(self):
        code = re.search(r'```python\n(.*?)```', read('README.md'), re.DOTALL)[1]
        plants = [  # id, diameter, quality, score
            (0, '0.02', 'ok', 0.5),
            (1, '0.02', 'short_stem|height_shifted', 0.7),
            (2, '0.02', 'poor_fit', 0.9),
            (3, 'nan', 'too_few_points', 0.2),
            (4, '0.02', 'short_stem|low_confidence', 0.8),
        ]
        found = {}
        with tempfile.TemporaryDirectory() as folder:
            table_name = os.path.join(folder, 'plants.csv')
            with open(table_name, 'w') as table:
                writer = csv.writer(table)
                writer.writerow(('plant_id', 'stem_diameter', 'quality', 'score'))
                writer.writerows(plants)
            exec(code.replace("'plants.csv'", repr(table_name)), found)
        ids = {
            name: [int(plant['plant_id']) for plant in found[name]]
            for name in ('counted', 'with_diameter', 'best_first')
        }
        self.assertEqual(ids['counted'], [0, 1, 2, 3])
        self.assertEqual(ids['with_diameter'], [0, 1])
        self.assertEqual(ids['best_first'], [2, 1, 0, 3])
        documented = first_cells(part(OUTPUT, 'Quality flags'))
        for flag in re.findall(r"'(\w+_\w+)'", code):
            self.assertIn(flag, documented + first_cells(part(OUTPUT, 'plants.csv')))

    def test_launch_arguments_are_those_of_the_launch_files(self):
        for launch, page, heading in (
            ('field_phenotyping.launch', 'docs/live.md', 'Arguments'),
            ('replay.launch', 'docs/bags.md', 'Replay it'),
        ):
            root = xml.etree.ElementTree.fromstring(read('launch', launch))
            given = {
                arg.get('name'): arg.get('default')
                for arg in root.findall('arg')
                if arg.get('value') is None
            }
            said = part(page, heading)
            self.assertEqual(sorted(given), sorted(first_cells(said)), page)
            rows = re.findall(r'^\| `(\w+)` \| `([^`]+)` \|', said, re.MULTILINE)
            self.assertGreater(len(rows), 3)
            for name, default in rows:
                self.assertTrue(
                    given[name] == default or given[name].endswith('/' + default), (page, name)
                )

    def test_every_parameter_that_is_read_is_documented(self):
        sources = glob.glob(os.path.join(ROOT, 'nodelets', '*.[ch]pp')) + [
            os.path.join(ROOT, 'tools', 'record_phenotypes.cpp')
        ]
        documented = first_cells(read(NODELETS))
        count = 0
        for source in sources:
            for name in re.findall(
                r'(?:param(?:<[\w:]+>)?\(|getParam\(|clamped\(pnh, |countOf\(pnh, )"(\w+)"', read(source)
            ):
                count += 1
                self.assertIn(name, documented, source)
        self.assertGreater(count, 20)

    def test_every_topic_and_service_is_documented(self):
        text = read(NODELETS)
        count = 0
        for source in glob.glob(os.path.join(ROOT, 'nodelets', '*.[ch]pp')):
            for name in re.findall(
                r'(?:advertise(?:<[\w:]+>)?\(|advertiseService\(|subscribe\()\s*"([\w/]+)"', read(source)
            ):
                count += 1
                self.assertIn('`' + ('' if name.startswith('/') else '~') + name + '`', text, source)
        self.assertGreater(count, 8)

    def test_every_equation_leads_to_code(self):
        equations = part('docs/paper.md', 'By equation')
        named = set()
        for first, last in re.findall(r'^\| (\d+)(?:(?:-|, )(\d+))? \|', equations, re.MULTILINE):
            named.update(range(int(first), int(last or first) + 1))
        self.assertEqual(named, set(range(1, 28)))
        header = None
        for row in equations.splitlines():
            if not row.startswith('| ') or row.startswith('| Eq'):
                continue
            words = re.findall(r'`([^`]+)`', row)
            self.assertTrue(words, row)
            for word in words:
                if word.endswith('.hpp'):
                    header = word
                elif re.fullmatch(r'[\w.]+', word) and word != '.cpp':
                    self.assertIn(word, read('include', 'field_phenotyping', header), row)

    def test_files_that_are_named_are_there(self):
        count = 0
        for page in ('docs/paper.md', 'docs/developing.md'):
            for name in re.findall(r'`([\w/]+/[\w.]+\.\w+)`', read(page)):
                count += 1
                places = ('', 'include/field_phenotyping', 'src', 'python/field_phenotyping_tools')
                self.assertTrue(
                    any(os.path.exists(os.path.join(ROOT, place, name)) for place in places),
                    page + ': ' + name,
                )
        self.assertGreater(count, 60)

    def test_links_lead_somewhere(self):
        for page in pages():
            links = re.findall(r'\]\((?!http)([^)#]*)(?:#([^)]*))?\)', read(page))
            self.assertTrue(links, page)
            for file, anchor in links:
                target = os.path.join(os.path.dirname(page), file) if file else page
                self.assertTrue(os.path.exists(os.path.join(ROOT, target)), page + ': ' + file)
                if anchor:
                    self.assertIn(anchor, anchors(read(target)), page + ': ' + file)

    def test_the_readme_leads_to_every_page(self):
        for page in pages()[1:]:
            self.assertIn('](' + page + ')', read('README.md'))


if __name__ == '__main__':
    PHENOTYPE_CLOUD = sys.argv.pop(1)
    update() if '--update' in sys.argv else unittest.main()
