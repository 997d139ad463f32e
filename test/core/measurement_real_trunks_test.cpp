// Real tree trunks with taped diameters: proves the estimator on noise and gaps nobody simulated.

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"

namespace field_phenotyping {
namespace {

const std::string kFolder = std::string(FIELD_PHENOTYPING_DATA) + "/treescope_trunks/";

/// Binary PCD with the fields x y z (float32) and part (uint8).
std::vector<Eigen::Vector3d> readPoints(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::size_t count = 0;
  for (std::string line; std::getline(file, line) && line.rfind("DATA", 0) != 0;) {
    if (line.rfind("POINTS", 0) == 0) count = std::stoul(line.substr(7));
  }
  std::vector<Eigen::Vector3d> points(count);
  for (Eigen::Vector3d& point : points) {
    std::array<char, 13> record{};
    file.read(record.data(), record.size());
    std::array<float, 3> xyz{};
    std::memcpy(xyz.data(), record.data(), sizeof(xyz));
    point << xyz[0], xyz[1], xyz[2];
  }
  EXPECT_TRUE(file.good()) << path;
  return points;
}

TEST(RealTrunks, TapedDiameters) {
  std::ifstream truth(kFolder + "truth.csv");
  if (!truth) GTEST_SKIP() << "SKIPPED: real data not found at " << kFolder;

  double sum = 0.0, squares = 0.0, circle_sum = 0.0, circle_squares = 0.0;
  int count = 0, covered = 0;
  std::string line;
  std::getline(truth, line);
  while (std::getline(truth, line)) {
    const std::size_t comma = line.find(',');
    const double taped = std::stod(line.substr(comma + 1));
    std::vector<Eigen::Vector3d> points = readPoints(kFolder + line.substr(0, comma));
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& point : points) mean += point;
    mean /= static_cast<double>(points.size());
    std::vector<Eigen::Vector2d> flat;
    for (Eigen::Vector3d& point : points) {
      point -= mean;
      flat.emplace_back(point.head<2>());
    }
    const StemCrossSection fit = fitStemCrossSection(points, CrossSectionPrior());
    ASSERT_TRUE(fit.valid) << line;
    // A tape reads the perimeter over pi, which is (a + b) to second order in the ellipticity.
    const double error = 2.0 * fit.radius.value - taped;
    const double circle_error = 2.0 * fitCircle(flat).radius - taped;
    std::printf(
        "%-13s taped %.3f fitted %.3f +- %.4f circle %.3f noise %.4f outliers %.2f arc %.2f%s\n",
        line.substr(0, comma).c_str(), taped, 2.0 * fit.radius.value, 2.0 * fit.radius.stddev,
        taped + circle_error, fit.noise, fit.outlier_share, fit.arc_coverage,
        fit.converged ? "" : " NOT CONVERGED");
    sum += error;
    squares += error * error;
    circle_sum += circle_error;
    circle_squares += circle_error * circle_error;
    covered += std::abs(error) < 1.96 * 2.0 * fit.radius.stddev ? 1 : 0;
    ++count;
  }
  ASSERT_EQ(count, 16);
  const double rmse = std::sqrt(squares / count);
  std::printf("trunks: RMSE %.4f m, bias %+.4f m, coverage %.2f; circle: RMSE %.4f, bias %+.4f\n",
              rmse, sum / count, static_cast<double>(covered) / count,
              std::sqrt(circle_squares / count), circle_sum / count);
  EXPECT_LT(rmse, 0.03);
}

}  // namespace
}  // namespace field_phenotyping
