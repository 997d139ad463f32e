#include <tbb/global_control.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>
#include <thread>

#include "simulation/progress.hpp"
#include "simulation/settings_json.hpp"
#include "simulation/simulation.hpp"
#include "simulation/writers.hpp"
#ifdef FIELD_PHENOTYPING_WITH_ROS
#include "simulation/bag_writer.hpp"
#endif

namespace {

namespace simulation = field_phenotyping::simulation;

struct Options {
  simulation::SimulationSettings settings;
  std::string stage = "tasselling";
  std::string output;
  bool no_bag = false;
  bool registered = false;
  bool stem_surface = false;
  double start_time = 1700000000.0;
  unsigned threads = 0;
};

/// Adds an option whose help shows its unit and its default.
template <typename Value>
CLI::Option* add(CLI::App& app, const std::string& name, Value& value, const char* unit,
                 const std::string& help, const char* group) {
  return app.add_option(name, value, help)
      ->capture_default_str()
      ->type_name(std::string("[") + unit + "]")
      ->group(group);
}

void addFieldOptions(CLI::App& app, Options& options) {
  const char* group = "Field";
  simulation::FieldSettings& field = options.settings.field;
  add(app, "--stage", options.stage, "name", "Growth stage: seedling, jointing, tasselling or ripe",
      group)
      ->check(CLI::IsMember({"seedling", "jointing", "tasselling", "ripe"}));
  add(app, "--rows", field.rows, "count", "Number of rows", group);
  add(app, "--plants-per-row", field.plants_per_row, "count",
      "Plants in each row; 0: no maize, only soil and weeds", group);
  add(app, "--row-spacing", field.row_spacing, "m", "Distance between rows", group);
  add(app, "--plant-spacing", field.plant_spacing, "m", "Distance between plants in a row", group);
  add(app, "--position-stddev", field.position_stddev, "m",
      "Standard deviation of each plant's place, along and across its row", group);
  add(app, "--missing", field.missing_share, "share", "Share of the plants that did not come up",
      group);
  add(app, "--row-azimuth", field.row_azimuth_deg, "deg",
      "Direction of the rows, anticlockwise from the map's x axis", group);
  add(app, "--bare-length", field.bare_length, "m", "Length of the plot when --plants-per-row is 0",
      group);
  add(app, "--weeds", field.weeds, "count",
      "Rosettes and tufts of grass, 5-25 cm high, at random places", group);
}

void addPlantOptions(CLI::App& app, simulation::PlantSettings& plant) {
  const char* group = "Plants";
  add(app, "--plant-height", plant.mean_height, "m",
      "Mean height to the highest point; 0: the stage's own (0.4, 1.2, 2.05, 2.0)", group);
  add(app, "--stem-diameter", plant.mean_stem_diameter, "m",
      "Mean major diameter at the measuring height; 0: the stage's own (0.010, 0.019, 0.022, "
      "0.0215)",
      group);
  add(app, "--size-stddev", plant.size_stddev, "share",
      "Standard deviation of plant size, share of the mean", group);
  add(app, "--lean-stddev", plant.lean_stddev_deg, "deg",
      "Standard deviation of the stems' lean from vertical (14: a lodged field)", group);
  add(app, "--diameter-height", plant.diameter_height, "m",
      "Height above the soil of the true diameter; at most 0.4 of the stem's length is used",
      group);
}

void addTerrainOptions(CLI::App& app, simulation::TerrainSettings& terrain) {
  const char* group = "Soil";
  add(app, "--slope", terrain.slope_deg, "deg", "Slope of the field", group);
  add(app, "--slope-azimuth", terrain.slope_azimuth_deg, "deg",
      "Uphill direction, anticlockwise from the map's x axis", group);
  add(app, "--ridge-height", terrain.ridge_height, "m",
      "Height of the ridges the rows stand on, crest to furrow", group);
  add(app, "--roughness", terrain.roughness, "m", "Standard deviation of the soil's height", group);
  add(app, "--roughness-correlation", terrain.roughness_correlation, "m",
      "Length over which the soil's roughness is alike", group);
}

void addRoverOptions(CLI::App& app, simulation::SimulationSettings& settings) {
  const char* group = "Rover";
  add(app, "--points", settings.target_points, "count",
      "Points of the merged cloud: the rover slows down to collect them, a surplus is thinned out "
      "at "
      "random. 0: all that --speed gives",
      group);
  add(app, "--speed", settings.rover.speed, "m/s",
      "Speed of the rover; lower where --points asks for it", group);
  add(app, "--lane-every", settings.rover.lane_every, "count",
      "Drive every n-th lane; lane 0 is outside the first row, the last one outside the last row",
      group);
  add(app, "--headland", settings.rover.headland, "m",
      "Distance driven beyond the ends of the rows", group);
  add(app, "--sway", settings.rover.sway_stddev_deg, "deg",
      "Standard deviation of the rover's roll and pitch", group);
  add(app, "--pose-noise", settings.rover.pose_noise, "m",
      "Standard deviation of each coordinate of the slowly varying error of the localisation",
      group);
  add(app, "--passes", settings.rover.passes, "count",
      "Times that the rover goes over the field: back and forth, over the lanes beside those of "
      "the "
      "pass before",
      group);
  add(app, "--map-shift", settings.rover.map_shift, "m",
      "Shift of the localisation's map after each pass, in a random horizontal direction from the "
      "first pass's; the merged cloud is blurred by as much",
      group);
  add(app, "--origin-x", settings.origin.x(), "m", "Map x of the first plant's nominal place",
      group);
  add(app, "--origin-y", settings.origin.y(), "m", "Map y of the first plant's nominal place",
      group);
  add(app, "--origin-z", settings.origin.z(), "m", "Map z of the first plant's nominal place",
      group);
}

void addLidarOptions(CLI::App& app, simulation::LidarSettings& lidar) {
  const char* group = "LiDAR";
  add(app, "--beams", lidar.beams, "count", "Number of beams", group);
  add(app, "--vertical-fov", lidar.vertical_fov_deg, "deg",
      "Angle from the lowest to the highest beam, centred on the scanning plane", group);
  add(app, "--point-rate", lidar.point_rate, "1/s", "Pulses per second, all beams together", group);
  add(app, "--scan-rate", lidar.scan_rate, "Hz", "Turns per second; one scan each", group);
  add(app, "--mount-height", lidar.mount_height, "m", "Height of the optical centre", group);
  add(app, "--head-tilt", lidar.head_tilt_deg, "deg", "Angle of the spin axis from the mast",
      group);
  add(app, "--head-rate", lidar.head_rate, "Hz",
      "Turns per second of the tilted head round the mast; 0: fixed, tilted forwards", group);
  add(app, "--noise", lidar.range_noise, "m", "Standard deviation of the range", group);
  add(app, "--divergence", lidar.divergence_mrad, "mrad",
      "Full divergence of the beam at 1/e^2; 0: an infinitely thin ray", group);
  add(app, "--range-resolution", lidar.range_resolution, "m",
      "Surfaces in one beam closer than this in range give one mixed return, else the strongest "
      "is returned",
      group);
  add(app, "--dropout", lidar.dropout_share, "share", "Share of the returns lost at random", group);
  add(app, "--min-range", lidar.min_range, "m", "Nearest return", group);
  add(app, "--max-range", lidar.max_range, "m", "Farthest return", group);
}

void addGeneralOptions(CLI::App& app, Options& options) {
  const char* group = "General";
  app.add_option("--output", options.output, "Folder to write to; made where missing")
      ->required()
      ->type_name("[folder]")
      ->group(group);
  add(app, "--seed", options.settings.seed, "number", "Same seed and settings: same bytes", group);
  add(app, "--threads", options.threads, "count", "Threads; 0: one per core", group);
  app.add_flag("--stem-surface", options.stem_surface,
               "Also write stem_surface.pcd: the true stem surfaces every 2 mm, with normals")
      ->group(group);
#ifdef FIELD_PHENOTYPING_WITH_ROS
  app.add_flag("--no-bag", options.no_bag, "Do not write field.bag")->group(group);
  app.add_flag("--registered", options.registered,
               "Write the bag's scans in the frame map instead of lidar")
      ->group(group);
#else
  app.add_flag("--no-bag", options.no_bag, "Accepted; this build without ROS writes no bag")
      ->group(group);
#endif
  add(app, "--start-time", options.start_time, "s", "Stamp of the first scan", group)
      ->default_str("1700000000");
}

void makeFolder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error || !std::filesystem::is_directory(folder)) {
    throw std::runtime_error("cannot make the folder " + folder + ": " + error.message() +
                             "; give a writable place with --output");
  }
}

void run(const Options& options) {
  makeFolder(options.output);
  const std::filesystem::path folder(options.output);
  simulation::ProgressBar bar;
  const auto progress = [&bar](const char* step, double share) { bar.update(step, share); };
  const simulation::Simulation result = simulation::simulate(options.settings, progress);

  progress("writing clouds", 0.0);
  simulation::writeCloud(result, folder / "cloud.pcd");
  simulation::writeTruth(result, folder / "truth.csv");
  simulation::writeTrajectory(result, options.start_time, folder / "trajectory.csv");
  simulation::writeSettings(result, folder / "simulation.json");
  if (options.stem_surface) {
    simulation::writeStemSurface(result, folder / "stem_surface.pcd");
  }
  progress("writing clouds", 1.0);
#ifdef FIELD_PHENOTYPING_WITH_ROS
  if (!options.no_bag) {
    simulation::BagSettings bag;
    bag.start_time = options.start_time;
    bag.registered = options.registered;
    simulation::writeBag(result, bag, folder / "field.bag", progress);
  }
#endif
  std::printf("%zu plants, %llu points in %zu scans, %.1f m driven at %.2f m/s: %s\n",
              result.field->plants.size(), static_cast<unsigned long long>(result.pointCount()),
              result.scans.size(), result.trajectory->length(), result.settings.rover.speed,
              options.output.c_str());
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app{
      "Simulates a maize field and a LiDAR driven through it. Writes to the output folder:\n"
      "  field.bag        scans, /tf and /tf_static (builds with ROS)\n"
      "  cloud.pcd        all points in the map frame with plant_id and part (0 ground or weed,\n"
      "                   1 stem, 2 other organ)\n"
      "  truth.csv        one line per plant, metres and radians\n"
      "  trajectory.csv   the sensor's pose at each scan\n"
      "  simulation.json  all settings and totals"};
  addGeneralOptions(app, options);
  addFieldOptions(app, options);
  addPlantOptions(app, options.settings.field.plant);
  addTerrainOptions(app, options.settings.field.terrain);
  addRoverOptions(app, options.settings);
  addLidarOptions(app, options.settings.lidar);
  CLI11_PARSE(app, argc, argv);
  try {
    options.settings.field.plant.stage = simulation::stageFromName(options.stage);
    const std::size_t threads =
        options.threads > 0 ? options.threads : std::max(1U, std::thread::hardware_concurrency());
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    run(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "simulate_field: %s\n", error.what());
    return 1;
  }
  return 0;
}
