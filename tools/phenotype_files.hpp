#pragma once

#include <memory>
#include <string>
#include <vector>

#include "field_phenotyping/completion/completed_block.hpp"
#include "field_phenotyping/measurement/phenotype.hpp"
#include "field_phenotyping/measurement/stand_summary.hpp"

// The files that people take the plants from. Shared by every program that writes them.

namespace field_phenotyping {

/// Writes one header row, then one row a plant in the order given: metres, radians, map frame. A
/// value that could not be measured is "nan"; `quality` holds the names of its flags, joined by
/// '|'. A reader sees the old file or the new one, never a half.
/// @throws std::runtime_error naming the file and the cause
void writePhenotypeCsv(const std::string& path, const std::vector<Phenotype>& plants);

/// Writes a GeoJSON FeatureCollection: one point a plant (x, y, z of its base [m] in `frame_id`,
/// not longitude and latitude), its traits as properties; null where a trait could not be measured.
/// As safe for readers as writePhenotypeCsv().
/// @throws std::runtime_error naming the file and the cause
void writePhenotypeGeoJson(const std::string& path, const std::vector<Phenotype>& plants,
                           const std::string& frame_id = "map");

/// Writes the rows that these plants stand in, as summariseRows() finds them: a header row, then
/// one row a row; metres, map frame. As safe for readers as writePhenotypeCsv().
/// @throws std::runtime_error naming the file and the cause
void writeRowsCsv(const std::string& path, const std::vector<Phenotype>& plants);

/// Writes a canopy height profile: a header row, then one row a layer, from the soil up. As safe.
/// @throws std::runtime_error naming the file and the cause
void writeCanopyCsv(const std::string& path, const std::vector<CanopyLayer>& layers);

/// Writes how the stem of each reported plant was grown: a header row, then one row a plant in the
/// order of their ids; metres, map frame. As safe for readers as writePhenotypeCsv().
/// @throws std::runtime_error naming the file and the cause
void writeGrowthCsv(const std::string& path,
                    const std::vector<std::shared_ptr<const CompletedBlock>>& blocks);

/// Writes the regions that these stems were grown in: a header row, then one row a region, plant by
/// plant and from the base up, numbered from 0; metres, map frame. As safe as writePhenotypeCsv().
/// @throws std::runtime_error naming the file and the cause
void writeGrowthRegionsCsv(const std::string& path,
                           const std::vector<std::shared_ptr<const CompletedBlock>>& blocks);

}  // namespace field_phenotyping
