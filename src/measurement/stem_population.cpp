#include "field_phenotyping/measurement/stem_population.hpp"

#include <algorithm>
#include <cmath>

#include "field_phenotyping/common/median.hpp"

namespace field_phenotyping {
namespace {

constexpr std::size_t kLeastStems = 6U;
constexpr double kMostOutliers = 0.3;    // share, in a fit that others learn from
constexpr double kMostPrior = 0.98;      // share of the prior in a fit beyond which it says nothing
constexpr double kLogNoiseStddev = 1.0;  // weak prior of the stems' noise
constexpr double kSizeStddev = 0.35;     // the same of their radius, relative to it
// Plants of one stand differ by 6 to 10 % in diameter. A prior more than twice as wide hardly moves
// a stem that is known as well as that, whatever plot it is of, and carries one that is not.
constexpr double kLooseSize = 0.2;
// Of stems whose points say little of their size most is known by their width, which misreads all
// of a stand alike, by leaf feet and noise: simulated seedlings of 0.2, 0.3 and 0.4 m by 27, 14 and
// 10 %, where the priors have a half to a third in what is known of one.
constexpr double kAlikeByWidth = 0.3;

/// What one stem's points alone say of a value.
struct Evidence {
  double mean = 0.0;
  double variance = 0.0;
};

/// Takes the prior out of a fit: nothing remains where the prior decided.
void addEvidence(const Trait& fit, double prior_mean, double prior_stddev,
                 std::vector<Evidence>& evidence) {
  const double posterior = fit.stddev * fit.stddev;
  const double prior = prior_stddev * prior_stddev;
  if (!(posterior > 0.0) || !(posterior < kMostPrior * prior)) return;
  const double variance = 1.0 / (1.0 / posterior - 1.0 / prior);
  evidence.push_back({variance * (fit.value / posterior - prior_mean / prior), variance});
}

/// Logarithm of how likely a spread of the population makes the evidence, its mean being unknown.
struct Likelihood {
  double value = 0.0;
  double mean = 0.0;  ///< best one
  double mean_variance = 0.0;
};

Likelihood likelihoodOf(const std::vector<Evidence>& evidence, double spread, double mean,
                        double mean_variance) {
  const double variance = spread * spread;
  Likelihood result;
  double weights = 1.0 / mean_variance;
  double sum = weights * mean;
  for (const Evidence& one : evidence) {
    const double weight = 1.0 / (variance + one.variance);
    weights += weight;
    sum += weight * one.mean;
    result.value += 0.5 * std::log(weight);
  }
  result.mean = sum / weights;
  result.mean_variance = 1.0 / weights;
  for (const Evidence& one : evidence) {
    const double deviation = one.mean - result.mean;
    result.value -= 0.5 * deviation * deviation / (variance + one.variance);
  }
  result.value -= 0.5 * std::log(weights);
  return result;
}

/// Mean over all spreads, each as likely as it makes the evidence. They go up to sqrt(3) times that
/// of the weak prior, so that stems that say nothing leave it as it is.
Trait populationOf(const std::vector<Evidence>& evidence, const Trait& weak, double mean_variance) {
  constexpr int kSteps = 64;
  const double step = std::sqrt(3.0) * weak.stddev / kSteps;
  std::vector<Likelihood> likelihoods;
  for (int i = 0; i < kSteps; ++i) {
    likelihoods.push_back(likelihoodOf(evidence, step * (i + 0.5), weak.value, mean_variance));
  }
  const double most =
      std::max_element(likelihoods.begin(), likelihoods.end(),
                       [](const Likelihood& a, const Likelihood& b) { return a.value < b.value; })
          ->value;
  double weights = 0.0, mean = 0.0, variance = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const Likelihood& likelihood = likelihoods[static_cast<std::size_t>(i)];
    const double weight = std::exp(likelihood.value - most);
    weights += weight;
    mean += weight * likelihood.mean;
    variance += weight * (std::pow(step * (i + 0.5), 2) + likelihood.mean_variance);
  }
  return {mean / weights, std::min(std::sqrt(variance / weights), weak.stddev)};
}

/// The same where the weak prior has no mean of its own: the middle of the stems.
Trait populationAround(const std::vector<Evidence>& evidence, double relative_stddev,
                       double stddev) {
  std::vector<double> means;
  for (const Evidence& one : evidence) means.push_back(one.mean);
  const double middle = medianOf(means);
  const Trait weak{middle, stddev + relative_stddev * std::abs(middle)};
  return populationOf(evidence, weak, weak.stddev * weak.stddev);
}

}  // namespace

CrossSectionPrior populationPrior(const std::vector<StemCrossSection>& fits,
                                  const CrossSectionPrior& weak, PopulationPrior kind) {
  std::vector<Evidence> taper, taper_change, log_noise, ellipticity, radius;
  double by_width = 0.0;
  for (const StemCrossSection& fit : fits) {
    if (!fit.valid || !fit.converged || fit.outlier_share > kMostOutliers) continue;
    addEvidence(fit.taper, weak.taper.value, weak.taper.stddev, taper);
    addEvidence(fit.taper_change, weak.taper_change.value, weak.taper_change.stddev, taper_change);
    log_noise.push_back({fit.log_noise.value, fit.log_noise.stddev * fit.log_noise.stddev});
    for (const double component : {fit.ellipticity.x(), fit.ellipticity.y()}) {
      addEvidence({component, fit.ellipticity_stddev}, 0.0, weak.ellipticity_stddev, ellipticity);
    }
    radius.push_back({fit.radius.value, fit.radius.stddev * fit.radius.stddev});
    by_width += fit.prior_share;
  }
  CrossSectionPrior prior = weak;
  if (log_noise.size() < kLeastStems) return prior;
  const auto squared = [](double stddev) { return stddev * stddev; };
  prior.taper = populationOf(taper, weak.taper, squared(weak.taper.stddev));
  prior.taper_change =
      populationOf(taper_change, weak.taper_change, squared(weak.taper_change.stddev));
  if (!(weak.noise > 0.0)) prior.log_noise = populationAround(log_noise, 0.0, kLogNoiseStddev);
  if (weak.ellipticity_stddev > 0.0) {
    constexpr double kKnown = 1e-6;  // stems are as often wide across the row as along it
    const Trait round{0.0, weak.ellipticity_stddev};
    prior.ellipticity_stddev = populationOf(ellipticity, round, squared(kKnown)).stddev;
  }
  prior.radius = populationAround(radius, kSizeStddev, 0.0);
  if (kind == PopulationPrior::kShape) {
    prior.radius.stddev = std::max(prior.radius.stddev, kLooseSize * prior.radius.value);
  }
  by_width /= static_cast<double>(radius.size());
  prior.radius_alike_stddev = kAlikeByWidth * by_width * prior.radius.value;
  return prior;
}

}  // namespace field_phenotyping
