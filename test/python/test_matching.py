import itertools
import unittest

import numpy as np

import support  # noqa: F401, finds the package
from field_phenotyping_tools import matching


def best_by_trying_all(first, second, radius):
    """(pairs, sum of distances) of the best one-to-one matching of a few points."""
    options = [
        [None] + [j for j in range(len(second)) if np.linalg.norm(first[i] - second[j]) <= radius]
        for i in range(len(first))
    ]
    best = (0, 0.0)
    for choice in itertools.product(*options):
        used = [j for j in choice if j is not None]
        if len(set(used)) == len(used):
            total = sum(
                np.linalg.norm(first[i] - second[j]) for i, j in enumerate(choice) if j is not None
            )
            if len(used) > best[0] or (len(used) == best[0] and total < best[1]):
                best = (len(used), total)
    return best


class MatchBases(unittest.TestCase):
    def test_agrees_with_trying_all(self):
        random = np.random.RandomState(7)
        for _ in range(60):
            first, second = random.rand(random.randint(1, 6), 2), random.rand(
                random.randint(1, 6), 2
            )
            radius = random.uniform(0.1, 0.6)
            pairs, distance = matching.match_bases(first, second, radius)
            count, total = best_by_trying_all(first, second, radius)
            self.assertEqual(len(pairs), count)
            self.assertAlmostEqual(distance.sum(), total)
            self.assertEqual(len(set(pairs[:, 0])), count)
            self.assertEqual(len(set(pairs[:, 1])), count)
            np.testing.assert_allclose(
                distance, np.linalg.norm(first[pairs[:, 0]] - second[pairs[:, 1]], axis=1)
            )

    def test_more_pairs_before_shorter_ones(self):
        # Nearest first would pair (0.05, 0.06) and leave the other two alone.
        first, second = np.array([[0.0, 0], [0.05, 0]]), np.array([[0.06, 0], [0.10, 0]])
        pairs, _ = matching.match_bases(first, second, 0.06)
        self.assertEqual(pairs.tolist(), [[0, 0], [1, 1]])

    def test_one_to_one(self):
        pairs, _ = matching.match_bases(np.zeros((1, 2)), np.array([[0.01, 0], [0.0, 0]]), 0.06)
        self.assertEqual(pairs.tolist(), [[0, 1]])

    def test_nothing_to_match(self):
        some, none = np.zeros((2, 2)), np.empty((0, 2))
        unknown = np.full((2, 2), np.nan)
        for first, second in ((some, none), (none, some), (some, unknown), (some, some + 1.0)):
            pairs, distance = matching.match_bases(first, second, 0.06)
            self.assertEqual(pairs.shape, (0, 2))
            self.assertEqual(distance.shape, (0,))

    def test_a_large_field_is_quick_and_exact(self):
        grid = np.stack(np.meshgrid(np.arange(100) * 0.75, np.arange(100) * 0.2), -1).reshape(-1, 2)
        order = np.random.RandomState(1).permutation(len(grid))
        pairs, distance = matching.match_bases(grid, grid[order] + [0.03, 0.04], 0.0501)
        self.assertEqual(len(pairs), len(grid))
        np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])
        np.testing.assert_allclose(distance, 0.05)


class Radius(unittest.TestCase):
    def test_six_centimetres_unless_plants_stand_closer(self):
        wide, close = np.array([[0.0, 0], [0.2, 0], [0.4, 0]]), np.array(
            [[0.0, 0], [0.1, 0], [0.2, 0]]
        )
        self.assertAlmostEqual(matching.default_radius(wide), 0.06)
        self.assertAlmostEqual(matching.default_radius(close), 0.05)
        self.assertAlmostEqual(matching.default_radius(wide[:1]), 0.06)
        self.assertAlmostEqual(matching.default_radius(wide[:0]), 0.06)


class MatchAxes(unittest.TestCase):
    def test_distance_is_taken_at_the_height_of_the_base(self):
        # The axis leans 0.1 m per metre along x: at z = -1 it stands at x = 0.
        point, direction = np.array([[0.2, 0.0, 1.0]]), np.array([[0.1, 0.0, 1.0]])
        bases = np.array([[0.03, 0.04, -1.0]])
        pairs, distance = matching.match_bases_to_axes(point, direction, bases, 0.051)
        self.assertEqual(pairs.tolist(), [[0, 0]])
        self.assertAlmostEqual(distance[0], 0.05)
        self.assertEqual(len(matching.match_bases_to_axes(point, direction, bases, 0.049)[0]), 0)


if __name__ == '__main__':
    unittest.main()
