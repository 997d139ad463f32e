#include "field_phenotyping/measurement/surface_mixture.hpp"

#include <vector>

#include "common/wide_vectors.hpp"
#include "field_phenotyping/common/serial_team.hpp"

namespace field_phenotyping {

SurfaceMixtureFit fitSurfaceMixture(const CrossSectionPoints& points, const CrossSectionTask& task,
                                    const CrossSectionStart& start) {
  const int bins = mixture::binsOf(start.parameters);
  std::vector<double> shared(mixture::sharedScratchSize(bins));
  std::vector<double> of_point(mixture::pointScratchSize(bins));
  SurfaceMixtureFit fit;
  withWideVectors([&] {
    fitSurfaceMixture(SerialTeam(), points, task, start, bins, shared.data(), of_point.data(), fit);
  });
  return fit;
}

}  // namespace field_phenotyping
