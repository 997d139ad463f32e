import math
import unittest

import numpy as np

import support  # noqa: F401, finds the package
from field_phenotyping_tools import checks, segmentation_scores, traits
from field_phenotyping_tools.errors import InputError


class TraitScores(unittest.TestCase):
    def test_worked_example(self):
        # errors 1 -1 2 0; truth mean 2.5, SS_tot 5, SS_res 6
        scores = traits.score_trait([1, 2, 3, 4], [2, 1, 5, 4], [1, 0.5, 1.1, 1])
        self.assertEqual(scores['n'], 4)
        self.assertAlmostEqual(scores['r2'], 1.0 - 6.0 / 5.0)
        self.assertAlmostEqual(scores['rmse'], math.sqrt(6.0 / 4.0))
        self.assertAlmostEqual(scores['mae'], 1.0)
        self.assertAlmostEqual(scores['bias'], 0.5)
        self.assertAlmostEqual(scores['median_abs_error'], 1.0)
        # covariance 5, variances 5 and 10: r squared = 25 / 50
        self.assertAlmostEqual(scores['squared_correlation'], 0.5)
        # z: 1, -2, 1.82, 0
        self.assertAlmostEqual(scores['coverage'], 0.75)

    def test_bias_lowers_r2_and_not_the_correlation(self):
        scores = traits.score_trait([1, 2, 3], [11, 12, 13])
        self.assertLess(scores['r2'], -100.0)
        self.assertAlmostEqual(scores['squared_correlation'], 1.0)
        self.assertTrue(math.isnan(scores['coverage']))

    def test_pairs_without_a_value_are_left_out(self):
        nan = float('nan')
        scores = traits.score_trait([1, 2, nan, 4], [1.5, nan, 3, 3], [nan, 1, 1, 0.6])
        self.assertEqual((scores['n'], scores['n_with_stddev']), (2, 1))
        self.assertAlmostEqual(scores['mae'], 0.75)
        self.assertAlmostEqual(scores['coverage'], 1.0)

    def test_zero_standard_deviation_claims_nothing(self):
        self.assertEqual(traits.score_trait([1.0], [1.1], [0.0])['n_with_stddev'], 0)

    def test_too_few_values(self):
        self.assertTrue(math.isnan(traits.score_trait([], [])['rmse']))
        one = traits.score_trait([1.0], [1.5])
        self.assertAlmostEqual(one['rmse'], 0.5)
        self.assertTrue(math.isnan(one['r2']))


class StemScores(unittest.TestCase):
    # On a line, 4 mm apart: 2 ground, 5 stem, 5 organ, 1 ground.
    truth = np.array([0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 0])
    said = np.array([1, 0, 1, 1, 1, 2, 1, 1, 2, 2, 2, 0, 0])
    positions = np.column_stack([np.arange(13) * 0.004, np.zeros(13), np.zeros(13)])

    def test_worked_example(self):
        scores = segmentation_scores.score_stem_class(self.positions, self.truth, self.said)
        # stem: 4 right, 1 on an organ, 1 on the ground, 1 missed
        self.assertAlmostEqual(scores['stem_precision'], 4 / 6)
        self.assertAlmostEqual(scores['stem_recall'], 4 / 5)
        self.assertAlmostEqual(scores['stem_f1'], 8 / 11)
        self.assertAlmostEqual(scores['stem_iou'], 4 / 7)
        self.assertEqual(scores['stem_on_ground_points'], 1)
        # of 10 stem and organ points, 1 stem and 1 organ are wrong
        self.assertAlmostEqual(scores['sa'], 0.8)
        # within 1 cm of the other class: 2 stem (indices 5, 6) and 2 organ (7, 8); said stem: 6, 7
        self.assertEqual(scores['boundary_points'], 4)
        self.assertAlmostEqual(scores['bp'], 0.5)

    def test_only_scored_points_count(self):
        scores = segmentation_scores.score_stem_class(
            self.positions, self.truth, self.said, self.truth > 0
        )
        self.assertAlmostEqual(scores['stem_precision'], 4 / 5)
        self.assertAlmostEqual(scores['stem_f1'], 8 / 10)

    def test_boundary_agrees_with_every_pair(self):
        random = np.random.RandomState(5)
        positions, part = random.rand(400, 3) * 0.1, random.randint(0, 3, 400)
        positions[3] = np.nan
        distance = np.linalg.norm(positions[:, None] - positions[None, :], axis=2)
        expected = [
            part[i] > 0 and bool(np.any(distance[i, (part > 0) & (part != part[i])] <= 0.01))
            for i in range(400)
        ]
        np.testing.assert_array_equal(
            segmentation_scores.boundary_points(positions, part), expected
        )
        self.assertTrue(0 < sum(expected) < 300)

    def test_one_class_only(self):
        scores = segmentation_scores.score_stem_class(
            self.positions, np.full(13, 2), np.full(13, 2)
        )
        self.assertEqual(scores['sa'], 1.0)
        self.assertTrue(math.isnan(scores['stem_f1']))
        self.assertTrue(math.isnan(scores['bp']))

    def test_plant_accuracy(self):
        truth, said = np.array([-1, 10, 10, 11, 11, 12]), np.array([3, 3, -1, 4, 3, 5])
        share, points = segmentation_scores.plant_accuracy(truth, said, {3: 10, 4: 11})
        self.assertEqual(points, 5)
        self.assertAlmostEqual(share, 2 / 5)  # plant 5 has no match: its point is wrong
        self.assertEqual(segmentation_scores.plant_accuracy(truth, said, {})[0], 0.0)
        self.assertTrue(math.isnan(segmentation_scores.plant_accuracy(truth[:1], said[:1], {})[0]))


class Checks(unittest.TestCase):
    figures = {'recall': 0.9, 'bias': -0.5, 'undefined': float('nan')}

    def test_met(self):
        self.assertEqual(
            checks.failed_checks(
                self.figures,
                [
                    'recall>=0.9',
                    ' recall < 1',
                    'recall<=0.9',
                    'bias>-1',
                    'recall == 0.9',
                    'bias!=0',
                ],
            ),
            [],
        )

    def test_not_met_undefined_or_missing(self):
        for condition in ('recall>0.9', 'recall==1', 'undefined>=0', 'undefined<=0', 'other>=0'):
            self.assertEqual(len(checks.failed_checks(self.figures, [condition])), 1, condition)

    def test_unreadable(self):
        for condition in ('recall', 'recall>=', 'recall>=high', '>=1', 'recall=>1'):
            with self.assertRaises(InputError):
                checks.failed_checks(self.figures, [condition])


if __name__ == '__main__':
    unittest.main()
