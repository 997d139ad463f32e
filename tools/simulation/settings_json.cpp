#include "simulation/settings_json.hpp"

#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace field_phenotyping::simulation {
namespace {

using Json = nlohmann::json;

Json fieldJson(const FieldSettings& field) {
  const PlantSettings& plant = field.plant;
  const TerrainSettings& terrain = field.terrain;
  return {{"stage", stageName(plant.stage)},
          {"rows", field.rows},
          {"plants_per_row", field.plants_per_row},
          {"row_spacing_m", field.row_spacing},
          {"plant_spacing_m", field.plant_spacing},
          {"position_stddev_m", field.position_stddev},
          {"missing_share", field.missing_share},
          {"row_azimuth_deg", field.row_azimuth_deg},
          {"bare_length_m", field.bare_length},
          {"weeds", field.weeds},
          {"mean_height_m", plant.mean_height},
          {"mean_stem_diameter_m", plant.mean_stem_diameter},
          {"size_stddev", plant.size_stddev},
          {"lean_stddev_deg", plant.lean_stddev_deg},
          {"diameter_height_m", plant.diameter_height},
          {"slope_deg", terrain.slope_deg},
          {"slope_azimuth_deg", terrain.slope_azimuth_deg},
          {"ridge_height_m", terrain.ridge_height},
          {"roughness_m", terrain.roughness},
          {"roughness_correlation_m", terrain.roughness_correlation}};
}

Json roverJson(const RoverSettings& rover) {
  return {{"speed_m_per_s", rover.speed},     {"lane_every", rover.lane_every},
          {"headland_m", rover.headland},     {"sway_stddev_deg", rover.sway_stddev_deg},
          {"pose_noise_m", rover.pose_noise}, {"passes", rover.passes},
          {"map_shift_m", rover.map_shift}};
}

Json shiftsJson(const Trajectory& trajectory) {
  Json shifts = Json::array();
  for (const Trajectory::Shift& pass : trajectory.shifts()) {
    shifts.push_back({{"time_s", pass.time}, {"x_m", pass.shift.x()}, {"y_m", pass.shift.y()}});
  }
  return shifts;
}

Json lidarJson(const LidarSettings& lidar) {
  return {{"beams", lidar.beams},
          {"vertical_fov_deg", lidar.vertical_fov_deg},
          {"point_rate_hz", lidar.point_rate},
          {"scan_rate_hz", lidar.scan_rate},
          {"mount_height_m", lidar.mount_height},
          {"head_tilt_deg", lidar.head_tilt_deg},
          {"head_rate_hz", lidar.head_rate},
          {"range_noise_m", lidar.range_noise},
          {"divergence_mrad", lidar.divergence_mrad},
          {"range_resolution_m", lidar.range_resolution},
          {"dropout_share", lidar.dropout_share},
          {"min_range_m", lidar.min_range},
          {"max_range_m", lidar.max_range}};
}

}  // namespace

void writeSettings(const Simulation& simulation, const std::string& path) {
  const SimulationSettings& settings = simulation.settings;
  std::uint64_t of_part[3] = {0, 0, 0};
  for (const Scan& scan : simulation.scans) {
    for (const LidarPoint& point : scan.points) {
      ++of_part[static_cast<std::size_t>(point.part)];
    }
  }
  const Json json = {{"seed", settings.seed},
                     {"target_points", settings.target_points},
                     {"origin_m", {settings.origin.x(), settings.origin.y(), settings.origin.z()}},
                     {"field", fieldJson(settings.field)},
                     {"rover", roverJson(settings.rover)},
                     {"lidar", lidarJson(settings.lidar)},
                     {"map_shifts", shiftsJson(*simulation.trajectory)},
                     {"totals",
                      {{"plants", simulation.field->plants.size()},
                       {"triangles", simulation.field->mesh.triangles.size()},
                       {"path_length_m", simulation.trajectory->length()},
                       {"duration_s", simulation.trajectory->duration()},
                       {"scans", simulation.scans.size()},
                       {"points", simulation.pointCount()},
                       {"ground_and_weed_points", of_part[0]},
                       {"stem_points", of_part[1]},
                       {"other_organ_points", of_part[2]}}}};
  std::ofstream file(path);
  file << json.dump(2) << '\n';
  file.close();
  if (!file) {
    throw std::runtime_error("cannot write " + path + ": is the disk full or read-only?");
  }
}

}  // namespace field_phenotyping::simulation
