// Fills the gaps of stems whose true surface is known, and scores what was filled; see --help.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <exception>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "completion_rivals.hpp"
#include "completion_scores.hpp"
#include "field_phenotyping/common/parallel.hpp"
#include "field_phenotyping/completion/stem_completion.hpp"
#include "gappy_stems.hpp"
#include "rows_file.hpp"
#include "simulation/progress.hpp"

namespace field_phenotyping::benchmark {
namespace {

struct Options {
  std::string output;
  SimulatedStems simulated;
  int stems = 12;
  int repeats = 5;
  bool odd = false;
  bool rivals = false;
  std::vector<std::string> real;
  std::vector<std::string> damages;
};

/// Our own completion, with its defaults: median seconds of a few runs.
struct Completed {
  FilledStem stem;
  CompletedStem points;
};

Completed complete(const GappyStem& stem, int repeats) {
  Completed completed;
  std::vector<double> seconds;
  const IndexSpan all{0U, static_cast<std::uint32_t>(stem.cloud.size())};
  for (int i = 0; i < repeats; ++i) {
    const std::clock_t start = std::clock();
    completed.points = completeStem(stem.cloud, all, stem.axis, stem.ground, {});
    seconds.push_back(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
  }
  std::nth_element(seconds.begin(), seconds.begin() + repeats / 2, seconds.end());
  completed.stem.measured = completed.points.solution.smoothed;
  completed.stem.filled = completed.points.points;
  completed.stem.stddev = completed.points.stddev;
  completed.stem.seconds = seconds[static_cast<std::size_t>(repeats / 2)];
  return completed;
}

nlohmann::json describe(const CloudScore& score) {
  return {{"pc", score.completeness}, {"sm", score.smoothness}, {"rd", score.resolution}};
}

nlohmann::json describe(const FilledStem& filled, const GappyStem& stem, double density) {
  std::vector<Eigen::Vector3f> whole = filled.measured;
  whole.insert(whole.end(), filled.filled.begin(), filled.filled.end());
  nlohmann::json row = describe(scoreCloud(whole, stem.truth, density));
  const SurfaceErrors errors = surfaceErrors(filled, stem.truth);
  row["filled"] = filled.filled.size();
  row["judged"] = errors.points;
  row["squares_m2"] = errors.squares;
  row["sum_m"] = errors.sum;
  row["seconds"] = filled.seconds;
  if (!filled.stddev.empty()) row["covered"] = errors.covered;
  float lowest = 0.0F;
  for (const Eigen::Vector3f& point : filled.filled) {
    lowest = std::min(lowest, stem.ground.empty() ? 0.0F : stem.ground.heightAbove(point));
  }
  row["deepest_m"] = -lowest;
  return row;
}

class Runner {
 public:
  explicit Runner(const Options& options) : options_(options) {
    if (options.rivals) rivals_ = rivalMethods();
  }

  void run(const GappyStem& stem, const std::string& damage) {
    const Completed ours = complete(stem, options_.repeats);
    const double density = ours.points.density;
    nlohmann::json row = start(stem, damage, "before", "");
    row.update(describe(scoreCloud(stem.cloud.points, stem.truth, density > 0.0 ? density : 1.0)));
    rows_.push_back(row);
    row = start(stem, damage, "ours", "default parameters");
    row["density_m2"] = density;
    row["flags"] = ours.points.solution.flags;
    row.update(describe(ours.stem, stem, density > 0.0 ? density : 1.0));
    rows_.push_back(row);
    if (!(density > 0.0)) return;
    for (const Rival& rival : rivals_) {
      row = start(stem, damage, rival.method, rival.settings);
      row.update(describe(rival.fill(stem, density), stem, density));
      rows_.push_back(row);
    }
  }

  const nlohmann::json& rows() const { return rows_; }

 private:
  static nlohmann::json start(const GappyStem& stem, const std::string& damage,
                              const std::string& method, const std::string& settings) {
    return {{"stem", stem.name},
            {"damage", damage},
            {"method", method},
            {"settings", settings},
            {"points", stem.cloud.size()}};
  }

  const Options& options_;
  std::vector<Rival> rivals_;
  nlohmann::json rows_ = nlohmann::json::array();
};

void run(const Options& options) {
  const ThreadLimit one_thread(1);
  simulation::ProgressBar bar;
  std::vector<Damage> damages = options.odd ? oddStems() : standardDamages();
  if (!options.damages.empty()) {
    damages.erase(std::remove_if(damages.begin(), damages.end(),
                                 [&](const Damage& damage) {
                                   return std::find(options.damages.begin(), options.damages.end(),
                                                    damage.name) == options.damages.end();
                                 }),
                  damages.end());
  }
  Runner runner(options);
  const std::size_t stems =
      options.real.empty() ? static_cast<std::size_t>(options.stems) : options.real.size();
  std::size_t done = 0U;
  for (std::size_t k = 0; k < stems; ++k) {
    for (const Damage& damage : damages) {
      bar.update("completing",
                 static_cast<double>(done++) / static_cast<double>(stems * damages.size()));
      runner.run(options.real.empty()
                     ? simulatedStem(options.simulated, static_cast<int>(k), damage)
                     : realStem(options.real[k], options.simulated.seed, damage),
                 damage.name);
    }
  }
  bar.update("completing", 1.0);
  writeRows(runner.rows(), options.output);
}

}  // namespace
}  // namespace field_phenotyping::benchmark

int main(int argc, char** argv) {
  field_phenotyping::benchmark::Options options;
  CLI::App app(
      "Fills the gaps of stems and scores the result by their true surface, on one thread; "
      "benchmark_completion makes\n"
      "tables of it. Stems are of the simulator, whose surface is exact, or real ones with pieces "
      "cut out, where a\n"
      "plane through the points that were there stands for the surface. Writes one JSON row for "
      "every stem, kind of\n"
      "gap and method: pc, sm, rd (Table 2 of the paper), seconds of one core, and of the filled "
      "points the number\n"
      "whose distance is known, the sum of its squares and its sum [m], and how many are within "
      "1.96 of their\n"
      "reported standard deviations.");
  app.add_option("-o,--output", options.output, "JSON file to write")->required();
  app.add_option("--seed", options.simulated.seed, "Of stems, noise and gaps")
      ->capture_default_str();
  app.add_option("--stems", options.stems, "Simulated stems")
      ->capture_default_str()
      ->check(CLI::Range(1, 10000));
  app.add_option("--points", options.simulated.points, "Points of a simulated stem without gaps")
      ->capture_default_str()
      ->check(CLI::Range(0, 10000000));
  app.add_option("--noise", options.simulated.noise,
                 "Standard deviation of a simulated point in x, y and z [m]")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 0.1));
  app.add_option("--repeats", options.repeats,
                 "Runs of our own, of whose seconds the median is taken")
      ->capture_default_str()
      ->check(CLI::Range(1, 1000));
  app.add_option("--damage", options.damages, "Only these kinds of gaps, by name");
  app.add_flag("--odd", options.odd, "Stems that can hardly be completed, instead of plain gaps");
  app.add_flag("--rivals", options.rivals,
               "Also moving least squares of the Point Cloud Library (MLS), the mean of the k "
               "nearest (kNN), voxel grid completion (VGC) and natural neighbours (NNI), each with "
               "all settings of a small grid");
  app.add_option("--real", options.real,
                 "Clouds of one real plant each, instead of simulated stems");
  CLI11_PARSE(app, argc, argv);
  try {
    field_phenotyping::benchmark::run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "complete_stems: error: %s\n", error.what());
    return 1;
  }
  return 0;
}
