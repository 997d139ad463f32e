#include "field_phenotyping/segmentation/midline.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace field_phenotyping {
namespace {

constexpr float kBandHeight = 0.10F;  // [m] along the axis
constexpr std::size_t kMinBandPoints = 8U;
constexpr float kMinSpread = 0.001F;  // [m]

float medianOf(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2U);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Bands among leaves spread more than the stem itself does, so a low quantile stands for the stem.
float lowQuantileOf(std::vector<float>& values) {
  const auto low = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 3U);
  std::nth_element(values.begin(), low, values.end());
  return *low;
}

/// Points of one band in the plane across the axis, relative to the prior's foot point.
struct Band {
  std::vector<Eigen::Vector2f> offsets;
  float arc_length = 0.0F;  // mean, along the prior
};

/// Horizontal-most basis across `direction`.
struct CrossFrame {
  Eigen::Vector3f u;
  Eigen::Vector3f v;

  explicit CrossFrame(const Eigen::Vector3f& direction)
      : u((Eigen::Vector3f::UnitX() - direction.x() * direction).normalized()),
        v(direction.cross(u)) {}
};

std::vector<Band> splitIntoBands(const std::vector<Eigen::Vector3f>& points,
                                 const std::vector<std::uint32_t>& members, const StemAxis& prior) {
  const auto count = std::max<std::size_t>(
      1U, static_cast<std::size_t>(std::lround(prior.length() / kBandHeight)));
  const float height = prior.length() / static_cast<float>(count);
  std::vector<Band> bands(count);
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = prior.project(points[i]);
    if (at.arc_length < -0.5F * height || at.arc_length > prior.length() + 0.5F * height) continue;
    const auto k = static_cast<std::size_t>(
        std::clamp(at.arc_length / height, 0.0F, static_cast<float>(count) - 0.5F));
    const CrossFrame frame(at.direction);
    const Eigen::Vector3f offset = points[i] - at.foot;
    bands[k].offsets.emplace_back(offset.dot(frame.u), offset.dot(frame.v));
    bands[k].arc_length += at.arc_length;
  }
  for (std::size_t k = 0; k < count; ++k) {
    const auto n = static_cast<float>(bands[k].offsets.size());
    bands[k].arc_length =
        n > 0.0F ? bands[k].arc_length / n : (static_cast<float>(k) + 0.5F) * height;
  }
  return bands;
}

struct Circle {
  Eigen::Vector2f center = Eigen::Vector2f::Zero();
  float radius = 0.0F;
  float spread = 0.0F;  // robust standard deviation of the residuals
  float weight = 0.0F;  // effective number of points; 0: not fitted
};

/// Geometric circle by iteratively reweighted Gauss-Newton; weak priors keep a half-seen stem from
/// running away.
Circle fitCircle(const std::vector<Eigen::Vector2f>& offsets, const Circle& prior,
                 float radius_stddev, float center_stddev) {
  Circle circle = prior;
  circle.weight = 0.0F;
  if (offsets.size() < kMinBandPoints) return circle;
  constexpr int kRounds = 12;
  std::vector<float> sizes(offsets.size());
  for (int round = 0; round < kRounds; ++round) {
    for (std::size_t i = 0; i < offsets.size(); ++i) {
      sizes[i] = std::abs((offsets[i] - circle.center).norm() - circle.radius);
    }
    std::vector<float> sorted = sizes;
    circle.spread = std::max(1.4826F * medianOf(sorted), kMinSpread);
    const float cutoff = 3.0F * circle.spread;

    const float variance = circle.spread * circle.spread;
    Eigen::Matrix3f normal = Eigen::Matrix3f::Zero();
    Eigen::Vector3f right = Eigen::Vector3f::Zero();
    circle.weight = 0.0F;
    for (const Eigen::Vector2f& offset : offsets) {
      const Eigen::Vector2f away = offset - circle.center;
      const float distance = std::max(away.norm(), 1e-6F);
      const float residual = distance - circle.radius;
      if (std::abs(residual) >= cutoff) continue;
      const float share = residual / cutoff;
      const float weight = (1.0F - share * share) * (1.0F - share * share);  // Tukey
      Eigen::Vector3f row;
      row << away / distance, 1.0F;
      normal += weight * row * row.transpose();
      right += weight * residual * row;
      circle.weight += weight;
    }
    const Eigen::Vector3f prior_weight(variance / (center_stddev * center_stddev),
                                       variance / (center_stddev * center_stddev),
                                       variance / (radius_stddev * radius_stddev));
    const Eigen::Vector3f away_from_prior(prior.center.x() - circle.center.x(),
                                          prior.center.y() - circle.center.y(),
                                          prior.radius - circle.radius);
    normal.diagonal() += prior_weight;
    right += prior_weight.cwiseProduct(away_from_prior);
    const Eigen::Vector3f step = normal.ldlt().solve(right);
    circle.center += step.head<2>();
    circle.radius = std::max(circle.radius + step[2], 1e-3F);
    constexpr float kConverged = 1e-5F;
    if (step.norm() < kConverged) break;
  }
  return circle;
}

/// Middle of the shortest interval that holds a third of the values: where they crowd.
float modeOf(std::vector<float>& values) {
  std::sort(values.begin(), values.end());
  const std::size_t share = std::max<std::size_t>(values.size() / 3U, 1U);
  std::size_t best = 0;
  for (std::size_t i = 0; i + share < values.size(); ++i) {
    if (values[i + share] - values[i] < values[best + share] - values[best]) best = i;
  }
  return 0.5F * (values[best] + values[std::min(best + share, values.size() - 1U)]);
}

/// The stem's typical radius: where the points' distances from the rough axis crowd, in the middle
/// of the bands. Leaf points lie farther out, but are scattered.
float typicalRadius(const std::vector<Band>& bands, float max_radius) {
  std::vector<float> modes;
  for (const Band& band : bands) {
    std::vector<float> distances;
    for (const Eigen::Vector2f& offset : band.offsets) {
      if (offset.norm() < 1.2F * max_radius) distances.push_back(offset.norm());
    }
    if (distances.size() >= kMinBandPoints) modes.push_back(modeOf(distances));
  }
  return modes.empty() ? 0.5F * max_radius : medianOf(modes);
}

/// How much a band's circle is to be believed: many points close to it.
float confidence(const Circle& circle) {
  constexpr float kMostPoints = 60.0F;
  constexpr float kScale = 0.003F;  // [m]
  const float relative = circle.spread / kScale;
  return std::min(circle.weight, kMostPoints) / (1.0F + relative * relative);
}

/// Centres averaged with the neighbouring bands; bands that were not fitted take theirs.
void smoothCenters(std::vector<Circle>& circles, const std::vector<float>& at) {
  const std::vector<Circle> raw = circles;
  constexpr float kReach = 0.12F;  // [m]
  for (std::size_t k = 0; k < raw.size(); ++k) {
    float total = 0.0F;
    Eigen::Vector2f center = Eigen::Vector2f::Zero();
    for (float reach = kReach; !(total > 0.0F) && reach < 10.0F; reach *= 2.0F) {
      for (std::size_t j = 0; j < raw.size(); ++j) {
        const float apart = (at[j] - at[k]) / reach;
        const float weight = confidence(raw[j]) * std::exp(-2.0F * apart * apart);
        constexpr float kNegligible = 1e-3F;
        if (weight < kNegligible) continue;
        center += weight * raw[j].center;
        total += weight;
      }
    }
    if (total > 0.0F) circles[k].center = center / total;
  }
}

/// A stem tapers: its radius is a line over the height. Robust, and more so against bands that look
/// too thick, since leaf bases do that to them; a weak prior on the taper carries the line up to
/// where only leaves are seen.
void taperRadii(std::vector<Circle>& circles, const std::vector<float>& at) {
  constexpr float kTaper = 0.25F;        // share of the lowest radius lost per metre
  constexpr float kTaperStddev = 0.12F;  // of the same
  constexpr float kThicker = 0.0007F;    // [m] residuals beyond which a band counts little
  constexpr float kThinner = 0.0015F;
  constexpr int kRounds = 15;
  std::vector<float> radii;
  for (const Circle& circle : circles) {
    if (circle.weight > 0.0F) radii.push_back(circle.radius);
  }
  if (radii.empty()) return;
  float level = lowQuantileOf(radii);
  float slope = -kTaper * level;
  for (int round = 0; round < kRounds; ++round) {
    const float slope_stddev = kTaperStddev * level;
    constexpr float kBandStddev = 0.002F;  // [m] of one fully believed band's radius
    const float prior = kBandStddev * kBandStddev / (slope_stddev * slope_stddev);
    Eigen::Matrix2f normal = Eigen::Vector2f(1e-6F, prior).asDiagonal();
    Eigen::Vector2f right(0.0F, -prior * kTaper * level);
    for (std::size_t k = 0; k < circles.size(); ++k) {
      const float residual = circles[k].radius - (level + slope * at[k]);
      const float relative = residual / (residual > 0.0F ? kThicker : kThinner);
      constexpr float kFullBelief = 30.0F;
      const float weight = confidence(circles[k]) / kFullBelief / (1.0F + relative * relative);
      const Eigen::Vector2f row(1.0F, at[k]);
      normal += weight * row * row.transpose();
      right += weight * circles[k].radius * row;
    }
    const Eigen::Vector2f solved = normal.ldlt().solve(right);
    level = std::max(solved[0], 1e-3F);
    slope = std::min(solved[1], 0.0F);
  }
  constexpr float kThinnest = 0.25F;  // of the radius at the base
  for (std::size_t k = 0; k < circles.size(); ++k) {
    circles[k].radius = std::max(level + slope * at[k], kThinnest * level);
  }
}

}  // namespace

Midline fitMidline(const std::vector<Eigen::Vector3f>& points,
                   const std::vector<std::uint32_t>& members, const StemAxis& prior,
                   float max_radius) {
  const std::vector<Band> bands = splitIntoBands(points, members, prior);
  std::vector<float> at;
  for (const Band& band : bands) at.push_back(band.arc_length);

  // 1. One circle a band, from the stem's typical radius.
  const float typical = typicalRadius(bands, max_radius);
  std::vector<Circle> circles;
  for (const Band& band : bands) {
    Circle start;
    start.radius = typical;
    circles.push_back(fitCircle(band.offsets, start, 0.25F * typical, 0.5F * typical));
  }
  // 2. Again from what all bands say together, which pulls back those that locked on to a leaf.
  std::vector<Circle> guide = circles;
  smoothCenters(guide, at);
  taperRadii(guide, at);
  for (std::size_t k = 0; k < bands.size(); ++k) {
    circles[k] = fitCircle(bands[k].offsets, guide[k], 0.1F * typical, 0.25F * typical);
  }
  // 3. Smoothed along the stem.
  std::vector<Circle> final_circles = circles;
  smoothCenters(final_circles, at);
  taperRadii(final_circles, at);

  Midline midline;
  std::vector<float> spreads;
  std::vector<StemAxis::Node> nodes;
  const auto addNode = [&](float s, const Circle& circle) {
    const CrossFrame frame(prior.directionAt(s));
    const Eigen::Vector3f position =
        prior.pointAt(s) + circle.center.x() * frame.u + circle.center.y() * frame.v;
    if (!nodes.empty() && position.z() <= nodes.back().position.z() + 0.01F) return;
    nodes.push_back({position, std::min(circle.radius, max_radius)});
  };
  addNode(0.0F, final_circles.front());
  for (std::size_t k = 0; k < final_circles.size(); ++k) {
    if (final_circles[k].weight > 0.0F) spreads.push_back(final_circles[k].spread);
    addNode(at[k], final_circles[k]);
  }
  addNode(prior.length(), final_circles.back());
  midline.axis = nodes.size() >= 2U ? StemAxis(std::move(nodes)) : prior;
  midline.spread = spreads.empty() ? 0.25F * typical : lowQuantileOf(spreads);
  return midline;
}

std::vector<std::uint32_t> pruneByMidline(const std::vector<Eigen::Vector3f>& points,
                                          const std::vector<std::uint32_t>& members,
                                          const StemAxis& axis, float factor) {
  const auto count =
      std::max<std::size_t>(1U, static_cast<std::size_t>(std::lround(axis.length() / kBandHeight)));
  const float height = axis.length() / static_cast<float>(count);
  std::vector<std::vector<float>> distances(count);
  const auto bandOf = [&](float s) {
    return static_cast<std::size_t>(std::clamp(s / height, 0.0F, static_cast<float>(count) - 0.5F));
  };
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = axis.project(points[i]);
    distances[bandOf(at.arc_length)].push_back(at.distance);
  }
  std::vector<float> thresholds;
  for (std::vector<float>& band : distances) {
    thresholds.push_back(band.empty() ? 0.0F : factor * medianOf(band));
  }
  std::vector<std::uint32_t> kept;
  for (const std::uint32_t i : members) {
    const StemAxis::Projection at = axis.project(points[i]);
    if (at.distance <= thresholds[bandOf(at.arc_length)]) kept.push_back(i);
  }
  return kept;
}

}  // namespace field_phenotyping
