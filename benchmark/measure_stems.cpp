// Measures stems whose truth is known, by our own and by other methods; see --help.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cloud_files.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/measurement/ellipse_fit.hpp"
#include "field_phenotyping/measurement/plant_height.hpp"
#include "field_phenotyping/measurement/stem_cross_section.hpp"
#include "field_phenotyping/measurement/stem_diameter.hpp"
#include "field_phenotyping/pipeline.hpp"
#include "found_stem.hpp"
#include "measurement_rivals.hpp"
#include "point_file.hpp"
#include "rows_file.hpp"
#include "simulation/random.hpp"
#include "stem_pieces.hpp"

namespace field_phenotyping::benchmark {
namespace {

using nlohmann::json;

struct Options {
  std::string output;
  PieceSettings piece;
  double arc_deg = 360.0;
  int trials = 200;
  bool noise_known = false;
  std::string field;
  std::vector<std::string> clouds;
  double kept_share = 0.1;
  int draws = 5;
};

/// JSON has no NaN: null.
json number(double value) {
  return std::isfinite(value) ? json(value) : json(nullptr);
}

json describe(const Trait& trait) {
  return {{"value", number(trait.value)}, {"stddev", number(trait.stddev)}};
}

json describe(const std::vector<RivalValue>& values) {
  json rows = json::array();
  for (const RivalValue& rival : values) {
    rows.push_back(
        {{"method", rival.method}, {"settings", rival.settings}, {"value", number(rival.value)}});
  }
  return rows;
}

std::vector<Eigen::Vector2d> flat(const std::vector<Eigen::Vector3d>& points) {
  std::vector<Eigen::Vector2d> result;
  result.reserve(points.size());
  for (const Eigen::Vector3d& point : points) result.emplace_back(point.head<2>());
  return result;
}

/// Diameter of Eq 27 and of a plain circle.
json plainFits(const std::vector<Eigen::Vector3d>& points) {
  const std::vector<Eigen::Vector2d> across = flat(points);
  const EllipseFit ellipse = fitAlgebraicEllipse(across);
  const CircleFit circle = fitCircle(across);
  return {{"paper", ellipse.valid ? json(2.0 * ellipse.semi_major) : json(nullptr)},
          {"circle", circle.valid ? json(2.0 * circle.radius) : json(nullptr)}};
}

/// Monte Carlo over pieces of stem.
json measurePieces(const Options& options) {
  PieceSettings settings = options.piece;
  settings.arc = options.arc_deg * M_PI / 180.0;
  CrossSectionPrior prior;
  if (options.noise_known) prior.noise = settings.noise;
  std::vector<json> rows(static_cast<std::size_t>(options.trials));
  parallelFor(rows.size(), [&](std::size_t i) {
    const StemPiece piece = drawStemPiece(settings, static_cast<int>(i));
    const StemCrossSection fit = fitStemCrossSection(piece.points, prior);
    json row = plainFits(piece.points);
    row["truth"] = piece.major;
    row["truth_minor"] = piece.minor;
    row["bound"] = cramerRaoBound(piece.feet, piece.major, piece.minor, settings.noise, prior);
    row["ours"] = describe(fit.valid ? fit.major : Trait());
    row["ours_minor"] = describe(fit.valid ? fit.minor : Trait());
    row["converged"] = fit.converged;
    row["prior_share"] = number(fit.prior_share);
    row["noise"] = number(fit.noise);
    row["arc_coverage"] = number(fit.arc_coverage);
    rows[i] = row;
  });
  return rows;
}

/// Points of a stem across and along the chord of its axis round height `z` [m], local frame.
std::vector<Eigen::Vector3d> pointsAcross(const std::vector<Eigen::Vector3f>& points,
                                          const StemAxis& axis, double z, double span) {
  std::vector<Eigen::Vector3d> across;
  for (const Eigen::Vector3f& point : points) {
    const double height = static_cast<double>(point.z()) - z;
    if (std::abs(height) > 0.5 * span) continue;
    const Eigen::Vector3d centre = axis.pointAtHeight(point.z()).cast<double>();
    const Eigen::Vector3d offset = point.cast<double>() - centre;
    across.emplace_back(offset.x(), offset.y(), height);
  }
  return across;
}

/// A plant whose stem points are `stem`, beside nothing else.
SegmentedBlock blockOf(const SegmentedBlock& block, const Plant& plant,
                       std::vector<Eigen::Vector3f> stem) {
  SegmentedBlock only;
  only.header = block.header;
  only.ground = block.ground;
  only.cloud.origin = block.cloud.origin;
  only.cloud.points = std::move(stem);
  Plant copy = plant;
  copy.points = {0U, static_cast<std::uint32_t>(only.cloud.size())};
  copy.stem = copy.points;
  only.plants = {copy};
  return only;
}

/// The truth in a cloud of simulate_field: whose every point is, and whether of a stem.
struct TrueLabels {
  std::vector<std::int32_t> plant;
  std::vector<bool> stem;
};

TrueLabels trueLabels(const CloudFile& file, const std::string& path) {
  const Field plant = requireField(file.contents, "plant_id", path);
  const Field part = requireField(file.contents, "part", path);
  TrueLabels labels;
  for (std::size_t i = 0; i < file.cloud.size(); ++i) {
    const std::uint8_t* point = file.contents.data.data() + i * file.contents.point_step;
    labels.plant.push_back(static_cast<std::int32_t>(plant.at(point)));
    labels.stem.push_back(part.at(point) == static_cast<double>(Part::kStem));
  }
  return labels;
}

/// True plant of most of the points that each found plant's stem was given.
std::map<std::int32_t, std::int32_t> trueIds(const PipelineResult& result,
                                             const TrueLabels& truth) {
  std::map<std::int32_t, std::map<std::int32_t, int>> counts;
  for (std::size_t i = 0; i < truth.plant.size(); ++i) {
    if (result.labels[i].part == Part::kStem) ++counts[result.labels[i].plant_id][truth.plant[i]];
  }
  std::map<std::int32_t, std::int32_t> ids;
  for (const auto& [found, of] : counts) {
    ids[found] = std::max_element(of.begin(), of.end(), [](const auto& a, const auto& b) {
                   return a.second < b.second;
                 })->first;
  }
  return ids;
}

/// What our fit makes of the true stem points, and what the bound says that they could give.
json withTrueLabels(const SegmentedBlock& block, const Plant& plant,
                    std::vector<Eigen::Vector3f> stem, const Options& options,
                    const MeasurementParameters& parameters) {
  const SegmentedBlock only = blockOf(block, plant, std::move(stem));
  const StemDiameter fit =
      measureStemDiameter(only, only.plants.front(), parameters, weakPrior(parameters));
  json row = {{"true_points", describe(fit.major)}, {"true_points_flags", flagNames(fit.flags)}};
  if (!std::isfinite(fit.major.value)) return row;
  std::vector<Eigen::Vector2d> feet;
  const double z = static_cast<double>(plant.base.z()) + fit.height;
  const auto across = pointsAcross(only.cloud.points, plant.axis, z, parameters.diameter_span);
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  const CircleFit circle = fitCircle(flat(across));
  if (circle.valid) centre = circle.center;
  for (const Eigen::Vector3d& point : across) {
    const Eigen::Vector2d offset = point.head<2>() - centre;
    feet.emplace_back(std::atan2(offset.y(), offset.x()) - fit.major_azimuth, point.z());
  }
  CrossSectionPrior prior;
  prior.ellipticity_stddev = parameters.ellipticity_prior;
  row["bound"] = cramerRaoBound(feet, fit.major.value, fit.minor.value, options.piece.noise, prior);
  row["true_points_count"] = across.size();
  return row;
}

/// Every plant that the pipeline finds in a simulated field, by all methods.
json measureField(const Options& options) {
  constexpr double kWidestSpan = 0.4;  // [m] that rivals may ask for
  const std::string path = options.field + "/cloud.pcd";
  const CloudFile file = readCloudFile(path);
  const TrueLabels truth = trueLabels(file, path);
  Parameters parameters;
  parameters.completion.enabled = false;
  const PipelineResult result = phenotypeCloud(file.cloud, parameters);
  const std::map<std::int32_t, std::int32_t> ids = trueIds(result, truth);
  std::map<std::int32_t, std::vector<Eigen::Vector3d>> stems;  // true points, map frame
  for (std::size_t i = 0; i < file.cloud.size(); ++i) {
    if (truth.stem[i]) stems[truth.plant[i]].push_back(file.cloud.mapPoint(i));
  }
  MeasurementParameters paper = parameters.measurement;
  paper.mode = "paper";
  std::map<std::int32_t, const Phenotype*> phenotypes;
  for (const Phenotype& phenotype : result.plants) phenotypes[phenotype.id] = &phenotype;

  json rows = json::array();
  for (const auto& completed : result.blocks) {
    const SegmentedBlock& block = *completed->segmented;
    const std::vector<PlantHeight> paper_heights = measurePlantHeights(block, paper, paper.noise);
    for (std::size_t k = 0; k < block.plants.size(); ++k) {
      const Plant& plant = block.plants[k];
      if (!plant.owned || plant.axis.empty()) continue;
      const Phenotype& ours = *phenotypes.at(plant.id);
      json row = {{"plant_id", plant.id},
                  {"x", ours.base.x()},
                  {"y", ours.base.y()},
                  {"quality", flagNames(ours.flags)},
                  {"diameter_height", number(ours.diameter_height)},
                  {"arc_coverage", number(ours.arc_coverage)},
                  {"diameter_points", ours.diameter_points},
                  {"stem_points", ours.stem_points}};
      row["diameter"] = describe(ours.stem_diameter);
      row["height"] = describe(ours.height);
      row["paper_height"] = describe(paper_heights[k].height);

      const auto at = block.cloud.points.begin();
      const std::vector<Eigen::Vector3f> stem(at + plant.stem.begin, at + plant.stem.end);
      const double z = static_cast<double>(plant.base.z()) + ours.diameter_height;
      row["diameters"] = describe(rivalDiameters(pointsAcross(stem, plant.axis, z, kWidestSpan)));
      std::vector<Eigen::Vector3d> whole;
      const double soil = static_cast<double>(plant.base.z());
      for (std::uint32_t i = plant.points.begin; i < plant.points.end; ++i) {
        const Eigen::Vector3d point = block.cloud.points[i].cast<double>();
        whole.emplace_back(point.x(), point.y(), point.z() - soil);
      }
      row["heights"] = describe(rivalHeights(whole));

      const auto id = ids.find(plant.id);
      if (id != ids.end()) {
        std::vector<Eigen::Vector3f> true_stem;
        for (const Eigen::Vector3d& point : stems[id->second]) {
          true_stem.push_back((point - block.cloud.origin).cast<float>());
        }
        row.update(
            withTrueLabels(block, plant, std::move(true_stem), options, parameters.measurement));
      }
      rows.push_back(row);
    }
  }
  return rows;
}

/// Real stems: our fit on all points, and on few of them with noise added, at many heights.
json measureReal(const Options& options) {
  constexpr double kStep = 0.1;       // [m] between heights
  constexpr double kTopShare = 0.85;  // of the stem: above it whorl and tassel begin
  json rows = json::array();
  for (const std::string& path : options.clouds) {
    const FoundStem found = findStem(readCloudFile(path).cloud, path);
    const SegmentedBlock& block = *found.block->segmented;
    const Plant& plant = *found.plant;
    MeasurementParameters parameters;
    parameters.diameter_height_share = 1.0;
    parameters.max_shift = 0.0;
    const double top = kTopShare * static_cast<double>(plant.axis.length());
    for (double height = 2.0 * kStep; height < top; height += kStep) {
      parameters.diameter_height = height;
      const StemDiameter whole =
          measureStemDiameter(block, plant, parameters, weakPrior(parameters));
      for (int draw = 0; draw < options.draws; ++draw) {
        simulation::RandomStream random(options.piece.seed, simulation::Stream::kThinning,
                                        static_cast<std::uint64_t>(draw));
        std::vector<Eigen::Vector3f> thinned;
        for (std::uint32_t i = plant.stem.begin; i < plant.stem.end; ++i) {
          const bool kept = random.uniform() < options.kept_share;
          const Eigen::Vector3d noise(random.normal(), random.normal(), random.normal());
          if (!kept) continue;
          thinned.push_back(block.cloud.points[i] + (options.piece.noise * noise).cast<float>());
        }
        const SegmentedBlock only = blockOf(block, plant, std::move(thinned));
        const StemDiameter thin =
            measureStemDiameter(only, only.plants.front(), parameters, weakPrior(parameters));
        rows.push_back({{"plant", std::filesystem::path(path).stem().string()},
                        {"height", height},
                        {"draw", draw},
                        {"whole", describe(whole.major)},
                        {"whole_equivalent", describe(whole.equivalent)},
                        {"whole_quality", flagNames(whole.flags)},
                        {"thinned", describe(thin.major)},
                        {"thinned_equivalent", describe(thin.equivalent)},
                        {"thinned_quality", flagNames(thin.flags)},
                        {"points", thin.points}});
      }
    }
  }
  return rows;
}

/// Pieces of trunk or stem, one a file: the diameter of the circle of the same perimeter, which is
/// what a tape reads.
json measureTrunks(const Options& options) {
  json rows = json::array();
  for (const std::string& path : options.clouds) {
    const CloudFile file = readCloudFile(path);
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < file.cloud.size(); ++i) mean += file.cloud.mapPoint(i);
    mean /= static_cast<double>(file.cloud.size());
    std::vector<Eigen::Vector3d> points;
    for (std::size_t i = 0; i < file.cloud.size(); ++i) {
      points.push_back(file.cloud.mapPoint(i) - mean);
    }
    const StemCrossSection fit = fitStemCrossSection(points, CrossSectionPrior());
    json row = plainFits(points);
    row["file"] = std::filesystem::path(path).filename().string();
    row["points"] = points.size();
    row["ours"] =
        describe(fit.valid ? Trait{2.0 * fit.radius.value, 2.0 * fit.radius.stddev} : Trait());
    row["noise"] = number(fit.noise);
    row["outlier_share"] = number(fit.outlier_share);
    row["arc_coverage"] = number(fit.arc_coverage);
    rows.push_back(row);
  }
  return rows;
}

}  // namespace
}  // namespace field_phenotyping::benchmark

int main(int argc, char** argv) {
  using namespace field_phenotyping::benchmark;
  Options options;
  CLI::App app(
      "Measures stems whose truth is known, by our own and by other methods; "
      "benchmark_measurement makes tables of it.\n"
      "Writes JSON rows, metres and radians, null where there is no value.");
  app.require_subcommand(1);
  const auto common = [&](CLI::App* command) {
    command->add_option("-o,--output", options.output, "JSON file to write")->required();
    command->add_option("--seed", options.piece.seed, "Of everything random")
        ->capture_default_str();
    command
        ->add_option("--noise", options.piece.noise,
                     "Standard deviation of a point along each axis [m]")
        ->capture_default_str()
        ->check(CLI::Range(0.0, 0.1));
  };

  CLI::App* pieces = app.add_subcommand("pieces", "Monte Carlo: single pieces of simulated stem");
  common(pieces);
  pieces->add_option("--trials", options.trials, "Pieces")
      ->capture_default_str()
      ->check(CLI::Range(1, 100000));
  pieces->add_option("--diameter", options.piece.diameter, "Major axis [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.001, 1.0));
  pieces->add_option("--points", options.piece.points, "Points of a piece")
      ->capture_default_str()
      ->check(CLI::Range(0, 1000000));
  pieces->add_option("--arc", options.arc_deg, "Part of the circumference that is seen [deg]")
      ->capture_default_str()
      ->check(CLI::Range(1.0, 360.0));
  pieces->add_option("--span", options.piece.span, "Length of a piece [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.001, 2.0));
  pieces->add_option("--outliers", options.piece.outlier_share, "Share of points of a leaf")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 1.0));
  pieces->add_flag("--noise-known", options.noise_known, "Our fit is told the noise");

  CLI::App* field = app.add_subcommand(
      "field",
      "Plants of a folder of simulate_field: whole pipeline, other methods on its plants, "
      "our fit on the true stem points");
  common(field);
  field->add_option("folder", options.field, "Folder of simulate_field")->required();

  CLI::App* real = app.add_subcommand(
      "real", "Stems of real plants: all points, and few of them with noise added");
  common(real);
  real->add_option("clouds", options.clouds, "Clouds of one real plant each")->required();
  real->add_option("--kept", options.kept_share, "Share of points that is kept")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 1.0));
  real->add_option("--draws", options.draws, "Draws of points and noise")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));

  CLI::App* trunks = app.add_subcommand("trunks", "Upright pieces of trunk, one in each cloud");
  common(trunks);
  trunks->add_option("clouds", options.clouds, "Clouds")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    if (pieces->parsed()) {
      writeRows(measurePieces(options), options.output);
    } else if (field->parsed()) {
      writeRows(measureField(options), options.output);
    } else if (real->parsed()) {
      writeRows(measureReal(options), options.output);
    } else {
      writeRows(measureTrunks(options), options.output);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "measure_stems: error: %s\n", error.what());
    return 1;
  }
  return 0;
}
