#include "simulation/lidar.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "simulation/random.hpp"

namespace field_phenotyping::simulation {
namespace {

constexpr int kRingRays = 4;
constexpr double kRingRadius = 0.68;  // of the half angle: the median of the outer four fifths
constexpr double kDetectionThreshold = 0.01;

struct RayEcho {
  double range;
  double energy;
  std::uint32_t surface;
};

/// Echoes of one pulse, nearest first.
struct PulseEchoes {
  std::array<RayEcho, kRingRays + 1> rays{};
  std::size_t count = 0;

  void add(const RayEcho& echo) {
    std::size_t place = count++;
    for (; place > 0 && rays[place - 1].range > echo.range; --place) {
      rays[place] = rays[place - 1];
    }
    rays[place] = echo;
  }
};

struct MergedEcho {
  std::size_t begin = 0, end = 0;
  double energy = 0.0;
};

/// The strongest run of rays whose gaps in range are within the resolution.
MergedEcho strongestEcho(const PulseEchoes& echoes, double range_resolution) {
  MergedEcho strongest;
  for (std::size_t begin = 0; begin < echoes.count;) {
    MergedEcho echo{begin, begin, 0.0};
    do {
      echo.energy += echoes.rays[echo.end].energy;
      ++echo.end;
    } while (echo.end < echoes.count &&
             echoes.rays[echo.end].range - echoes.rays[echo.end - 1].range < range_resolution);
    if (echo.energy > strongest.energy) {
      strongest = echo;
    }
    begin = echo.end;
  }
  return strongest;
}

/// The surface with most of the echo's energy, the nearest of equals.
std::uint32_t dominantSurface(const PulseEchoes& echoes, const MergedEcho& echo) {
  double most = 0.0;
  std::uint32_t dominant = 0;
  for (std::size_t i = echo.begin; i < echo.end; ++i) {
    double energy = 0.0;
    for (std::size_t j = echo.begin; j < echo.end; ++j) {
      energy += echoes.rays[j].surface == echoes.rays[i].surface ? echoes.rays[j].energy : 0.0;
    }
    if (energy > most) {
      most = energy;
      dominant = echoes.rays[i].surface;
    }
  }
  return dominant;
}

}  // namespace

Lidar::Lidar(const LidarSettings& settings, const TriangleMesh& mesh, const RayCaster& caster,
             const Trajectory& trajectory, std::uint64_t seed)
    : settings_(settings), mesh_(mesh), caster_(caster), trajectory_(trajectory), seed_(seed) {
  validate(settings);
  columns_per_scan_ = static_cast<std::uint64_t>(
      std::max(1.0, std::round(settings.point_rate / (settings.scan_rate * settings.beams))));
}

std::uint64_t Lidar::columnCount() const {
  return static_cast<std::uint64_t>(std::ceil(trajectory_.duration() * settings_.scan_rate *
                                              static_cast<double>(columns_per_scan_)));
}

std::uint64_t Lidar::scanCount() const {
  return (columnCount() + columns_per_scan_ - 1) / columns_per_scan_;
}

Eigen::Isometry3d Lidar::mast() const {
  return Eigen::Isometry3d(Eigen::Translation3d(0.0, 0.0, settings_.mount_height));
}

Eigen::Isometry3d Lidar::head(double time) const {
  Eigen::Isometry3d head = Eigen::Isometry3d::Identity();
  head.rotate(Eigen::AngleAxisd(2.0 * M_PI * settings_.head_rate * time, Eigen::Vector3d::UnitZ()));
  head.rotate(Eigen::AngleAxisd(settings_.head_tilt_deg * M_PI / 180.0, Eigen::Vector3d::UnitY()));
  return head;
}

double Lidar::columnTime(std::uint64_t column) const {
  return static_cast<double>(column) /
         (settings_.scan_rate * static_cast<double>(columns_per_scan_));
}

Eigen::Vector3d Lidar::beamDirection(std::uint64_t column, std::int32_t beam) const {
  const double azimuth = 2.0 * M_PI * static_cast<double>(column % columns_per_scan_) /
                         static_cast<double>(columns_per_scan_);
  const double share =
      settings_.beams > 1 ? static_cast<double>(beam) / (settings_.beams - 1) : 0.5;
  const double elevation = settings_.vertical_fov_deg * (share - 0.5) * M_PI / 180.0;
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
          std::sin(elevation)};
}

std::optional<Lidar::Return> Lidar::fire(const Eigen::Isometry3d& T_map_lidar, std::uint64_t column,
                                         std::int32_t beam) const {
  const std::uint64_t pulse =
      column * static_cast<std::uint64_t>(settings_.beams) + static_cast<std::uint64_t>(beam);
  if (RandomStream(seed_, Stream::kDropout, pulse).uniform() < settings_.dropout_share) {
    return std::nullopt;
  }
  const Eigen::Vector3d origin = T_map_lidar.translation();
  const Eigen::Vector3d centre = T_map_lidar.linear() * beamDirection(column, beam);
  const bool thin = settings_.divergence_mrad == 0.0;
  const double ray_energy = thin ? 1.0 : 1.0 / (kRingRays + 1);
  PulseEchoes echoes;
  const auto castRay = [&](const Eigen::Vector3d& direction) {
    if (const auto hit = caster_.cast(origin, direction, settings_.max_range)) {
      const double reflectance = static_cast<double>(mesh_.surfaces[hit->surface].reflectance);
      echoes.add({hit->range, ray_energy * reflectance * hit->cosine, hit->surface});
    }
  };
  castRay(centre);
  if (!thin) {
    const double radius = kRingRadius * 0.5e-3 * settings_.divergence_mrad;
    const double phase = RandomStream(seed_, Stream::kFootprint, pulse).uniform(0.0, 0.5 * M_PI);
    const Eigen::Vector3d across = centre.unitOrthogonal();
    const Eigen::Vector3d other = centre.cross(across);
    for (int i = 0; i < kRingRays; ++i) {
      const double angle = phase + 2.0 * M_PI * i / kRingRays;
      castRay(
          (centre + radius * (std::cos(angle) * across + std::sin(angle) * other)).normalized());
    }
  }
  const MergedEcho echo = strongestEcho(echoes, settings_.range_resolution);
  if (echo.energy < kDetectionThreshold) {
    return std::nullopt;
  }
  double range = 0.0;
  for (std::size_t i = echo.begin; i < echo.end; ++i) {
    range += echoes.rays[i].range * echoes.rays[i].energy / echo.energy;
  }
  if (range < settings_.min_range) {
    return std::nullopt;
  }
  range += settings_.range_noise * RandomStream(seed_, Stream::kRangeNoise, pulse).normal();
  return Return{range, echo.energy, mesh_.surfaces[dominantSurface(echoes, echo)]};
}

Scan Lidar::scan(std::uint64_t index) const {
  Scan scan;
  const std::uint64_t first = index * columns_per_scan_;
  const std::uint64_t end = std::min(first + columns_per_scan_, columnCount());
  scan.time = columnTime(first);
  const Eigen::Isometry3d mounting = mast();
  const auto sensorPose = [&](double time) -> Eigen::Isometry3d {
    return trajectory_.pose(time) * mounting * head(time);
  };
  scan.T_map_lidar = trajectory_.estimatedPose(scan.time) * mounting * head(scan.time);
  const Eigen::Isometry3d T_start_map = sensorPose(scan.time).inverse();
  for (std::uint64_t column = first; column < end; ++column) {
    const Eigen::Isometry3d T_map_lidar = sensorPose(columnTime(column));
    const Eigen::Isometry3d T_start_lidar = T_start_map * T_map_lidar;
    for (std::int32_t beam = 0; beam < settings_.beams; ++beam) {
      if (const auto echo = fire(T_map_lidar, column, beam)) {
        LidarPoint point;
        point.position =
            (T_start_lidar * (echo->range * beamDirection(column, beam))).cast<float>();
        point.intensity = static_cast<float>(std::min(255.0 * echo->energy, 255.0));
        point.plant_id = echo->surface.plant_id;
        point.part = echo->surface.part;
        scan.points.push_back(point);
      }
    }
  }
  return scan;
}

std::uint32_t Lidar::countReturns(std::uint64_t column) const {
  const double time = columnTime(column);
  const Eigen::Isometry3d T_map_lidar = trajectory_.pose(time) * mast() * head(time);
  std::uint32_t count = 0;
  for (std::int32_t beam = 0; beam < settings_.beams; ++beam) {
    count += fire(T_map_lidar, column, beam) ? 1U : 0U;
  }
  return count;
}

void validate(const LidarSettings& settings) {
  const auto require = [](bool ok, const char* message) {
    if (!ok) {
      throw std::invalid_argument(message);
    }
  };
  require(settings.beams >= 1 && settings.beams <= 1024, "the LiDAR must have 1 to 1024 beams");
  require(settings.vertical_fov_deg >= 0.0 && settings.vertical_fov_deg < 180.0,
          "the LiDAR's field of view must be at least 0 and less than 180 deg");
  require(settings.point_rate > 0.0, "the point rate must be above 0 pulses per second");
  require(settings.scan_rate > 0.0, "the scan rate must be above 0 Hz");
  require(settings.mount_height > 0.0, "the LiDAR must be mounted above 0 m");
  require(settings.head_rate >= 0.0, "the head's turning rate must not be negative");
  require(settings.range_noise >= 0.0, "the range noise must not be negative");
  require(settings.divergence_mrad >= 0.0 && settings.divergence_mrad <= 100.0,
          "the beam divergence must be 0 to 100 mrad");
  require(settings.range_resolution >= 0.0, "the range resolution must not be negative");
  require(settings.dropout_share >= 0.0 && settings.dropout_share < 1.0,
          "the share of dropouts must be at least 0 and less than 1");
  require(settings.min_range >= 0.0 && settings.max_range > settings.min_range,
          "the greatest range must exceed the smallest one, which must not be negative");
}

}  // namespace field_phenotyping::simulation
