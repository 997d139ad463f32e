#pragma once

#include <string>

namespace field_phenotyping {

// Every tunable of the core. The in-class initialisers are the only defaults: the YAML reader, the
// dynamic_reconfigure files and the documentation are checked against them. Each struct lists its
// fields once, in visit(), with range, unit and meaning.

/// What a visitor learns about one parameter besides its value and range.
struct ParameterInfo {
  const char* name;
  const char* unit;  ///< "" for a pure number
  const char* description;
};

/// Denoising, soil, blocks (paper 2.3).
struct PreprocessingParameters {
  double min_range = 0.2;
  double max_range = 30.0;
  double min_x = -1e9, max_x = 1e9;
  double min_y = -1e9, max_y = 1e9;
  double min_z = -1e9, max_z = 1e9;
  double voxel_size = 0.003;
  double outlier_radius = 0.05;
  int outlier_min_neighbors = 2;
  double block_size = 4.0;
  double block_margin = 0.6;
  double ground_cell = 0.12;
  double ground_distance = 0.04;
  double ground_max_tilt = 25.0;
  double ground_min_coverage = 0.25;
  double max_density = 90000.0;
  double draft_density = 8000.0;
  double update_period = 2.0;
  double update_min_change = 0.5;
  double final_after = 5.0;
  double final_distance = 20.0;
  double memory_limit = 4.0e7;

  template <class Self, class Visitor>
  static void visit(Self& p, Visitor&& v) {
    v(ParameterInfo{"min_range", "m", "nearer returns (the rover itself) are dropped"}, p.min_range,
      0.0, 100.0);
    v(ParameterInfo{"max_range", "m", "farther returns are dropped"}, p.max_range, 0.1, 1000.0);
    v(ParameterInfo{"min_x", "m", "crop box in the target frame, smallest x"}, p.min_x, -1e9, 1e9);
    v(ParameterInfo{"max_x", "m", "crop box in the target frame, largest x"}, p.max_x, -1e9, 1e9);
    v(ParameterInfo{"min_y", "m", "crop box in the target frame, smallest y"}, p.min_y, -1e9, 1e9);
    v(ParameterInfo{"max_y", "m", "crop box in the target frame, largest y"}, p.max_y, -1e9, 1e9);
    v(ParameterInfo{"min_z", "m", "crop box in the target frame, smallest z"}, p.min_z, -1e9, 1e9);
    v(ParameterInfo{"max_z", "m", "crop box in the target frame, largest z"}, p.max_z, -1e9, 1e9);
    v(ParameterInfo{"voxel_size", "m", "edge of the voxels that scans accumulate in (2.3.1)"},
      p.voxel_size, 0.0005, 0.1);
    v(ParameterInfo{"outlier_radius", "m",
                    "reach within which a point must have neighbours; widened for sparse clouds"},
      p.outlier_radius, 0.001, 1.0);
    v(ParameterInfo{"outlier_min_neighbors", "",
                    "points with fewer neighbours are noise, if no plant's; 0 keeps all"},
      p.outlier_min_neighbors, 0, 100);
    v(ParameterInfo{"block_size", "m", "edge of the square tiles that the scene is worked in"},
      p.block_size, 0.5, 100.0);
    v(ParameterInfo{"block_margin", "m",
                    "of neighbouring tiles that goes with a block so that border plants are whole; "
                    "half of it until no more comes"},
      p.block_margin, 0.0, 5.0);
    v(ParameterInfo{"ground_cell", "m",
                    "planes are fitted to the soil this far apart, and twice as close it is "
                    "settled on its points"},
      p.ground_cell, 0.05, 5.0);
    v(ParameterInfo{"ground_distance", "m", "points nearer to the soil than this are soil (2.3.2)"},
      p.ground_distance, 0.005, 0.5);
    v(ParameterInfo{"ground_max_tilt", "deg",
                    "steepest soil plane that RANSAC accepts, from gravity"},
      p.ground_max_tilt, 0.0, 60.0);
    v(
        ParameterInfo{
            "ground_min_coverage", "",
            "share of the seen area that must show soil, else the soil counts as cropped away"},
        p.ground_min_coverage, 0.01, 1.0);
    v(ParameterInfo{"max_density", "1/m^2",
                    "a block with more points above the soil is thinned to wider voxels: more "
                    "tell little more of its plants"},
      p.max_density, 1000.0, 1e9);
    v(
        ParameterInfo{
            "draft_density", "1/m^2",
            "the same of a block that has just changed, whose plants' first values must come soon"},
        p.draft_density, 1000.0, 1e9);
    v(ParameterInfo{"update_period", "s",
                    "a block that changed is handed on again after this long"},
      p.update_period, 0.1, 600.0);
    v(ParameterInfo{"update_min_change", "",
                    "share of new voxels that makes a block worth working again"},
      p.update_min_change, 0.0, 10.0);
    v(ParameterInfo{"final_after", "s", "a block that no scan has reached for this long is final"},
      p.final_after, 0.1, 3600.0);
    v(ParameterInfo{"final_distance", "m",
                    "a tile is forgotten once final and this far from the sensor"},
      p.final_distance, 1.0, 1000.0);
    v(ParameterInfo{"memory_limit", "",
                    "most voxels held; beyond it the oldest tiles are finished and forgotten"},
      p.memory_limit, 1e4, 1e10);
  }
};

/// Constrained region growth (paper 2.4).
struct SegmentationParameters {
  double M = 0.5;
  double M_branching = 0.8;
  double M_internode = 1.0;
  double r1 = 0.04;
  double alpha = 0.2;
  double beta = 0.8;
  int max_growth_steps = 200;
  double quality_target = 0.7;
  int max_growth_cycles = 4;
  double seed_min_height = 0.04;
  double seed_max_height = 1.2;
  double seed_slab = 0.05;
  double seed_radius = 0.04;
  double seed_min_length = 0.10;
  double seed_min_score = 2.0;
  double min_plant_spacing = 0.06;
  double row_spacing = 0.0;
  double plant_spacing = 0.0;
  double max_stem_radius = 0.03;
  double max_lean = 35.0;
  double prune_factor = 2.2;
  double organ_reach = 0.10;

  template <class Self, class Visitor>
  static void visit(Self& p, Visitor&& v) {
    v(ParameterInfo{"M", "",
                    "how alike a point must be to the growing stem to join it: more is stricter"},
      p.M, 0.01, 1.0);
    v(ParameterInfo{"M_branching", "", "share of M at nodes and branchings (3.1.2)"}, p.M_branching,
      0.1, 2.0);
    v(ParameterInfo{"M_internode", "", "share of M on smooth internodes (3.1.2)"}, p.M_internode,
      0.1, 2.0);
    v(ParameterInfo{"r1", "m", "radius of the growth sphere, and longest step (Eq 3)"}, p.r1, 0.005,
      0.5);
    v(ParameterInfo{"alpha", "",
                    "weight of the points' own direction in the growth direction (Eq 2)"},
      p.alpha, 0.0, 1.0);
    v(ParameterInfo{"beta", "", "weight of the direction to the segment's end (Eq 2)"}, p.beta, 0.0,
      1.0);
    v(ParameterInfo{"max_growth_steps", "", "a region stops growing after this many steps"},
      p.max_growth_steps, 1, 10000);
    v(
        ParameterInfo{
            "quality_target", "",
            "T: a stem that scores less (Q of Eq 9) is grown again with adapted parameters"},
        p.quality_target, 0.0, 1.0);
    v(ParameterInfo{"max_growth_cycles", "", "a stem is grown at most this often (Step 4)"},
      p.max_growth_cycles, 1, 100);
    v(ParameterInfo{"seed_min_height", "m",
                    "seeds are looked for from this height above the soil, or 0.03 of the plants' "
                    "if that is lower"},
      p.seed_min_height, 0.0, 2.0);
    v(ParameterInfo{"seed_max_height", "m",
                    "seeds are looked for up to this height above the soil"},
      p.seed_max_height, 0.1, 5.0);
    v(ParameterInfo{"seed_slab", "m",
                    "height of the slabs that stem evidence is collected in; widened likewise, and "
                    "lower in proportion for plants below 0.8 m"},
      p.seed_slab, 0.01, 0.5);
    v(
        ParameterInfo{
            "seed_radius", "m",
            "neighbourhood for the local shape of a point; widened by half in sparse clouds"},
        p.seed_radius, 0.01, 0.5);
    v(
        ParameterInfo{
            "seed_min_length", "m",
            "shortest upright run of stem evidence that makes a candidate for a stem; likewise"},
        p.seed_min_length, 0.02, 2.0);
    v(ParameterInfo{"seed_min_score", "",
                    "least stem evidence that makes a candidate for a stem, in slabs that show it"},
      p.seed_min_score, 0.1, 100.0);
    v(ParameterInfo{"min_plant_spacing", "m",
                    "two stems are at least this far apart at the soil unless seen side by side"},
      p.min_plant_spacing, 0.01, 2.0);
    v(ParameterInfo{"row_spacing", "m",
                    "between the rows that plants are expected in; 0: found from the plants"},
      p.row_spacing, 0.0, 5.0);
    v(ParameterInfo{"plant_spacing", "m",
                    "along a row that plants are expected at; 0: found from the plants"},
      p.plant_spacing, 0.0, 5.0);
    v(ParameterInfo{"max_stem_radius", "m", "thickest stem radius that is looked for"},
      p.max_stem_radius, 0.005, 0.5);
    v(ParameterInfo{"max_lean", "deg", "steepest lean of a stem from vertical"}, p.max_lean, 5.0,
      80.0);
    v(
        ParameterInfo{
            "prune_factor", "",
            "k of the midline pruning: points beyond k times the median distance go (2.4.2)"},
        p.prune_factor, 1.0, 10.0);
    v(ParameterInfo{"organ_reach", "m",
                    "gap that leaves and tassels are followed across; 1.6 times as far straight on "
                    "along a leaf"},
      p.organ_reach, 0.005, 1.0);
  }
};

/// Constrained adaptive RBF completion (paper 2.5).
struct CompletionParameters {
  bool enabled = true;
  double prior_weight = 0.7;
  double kernel_scale = 1.0;
  double ridge = 1e-3;
  int max_centers = 200;
  double max_gap = 0.25;
  double density = 0.0;
  int points_around = 34;
  double max_stddev = 0.0015;
  double smoothing = 0.3;
  int min_points = 12;

  template <class Self, class Visitor>
  static void visit(Self& p, Visitor&& v) {
    v(ParameterInfo{"enabled", "",
                    "fill gaps in the stems; off: only measured points are handed on"},
      p.enabled, false, true);
    v(ParameterInfo{"prior_weight", "",
                    "alpha of Eq 20: 1 trusts the points, 0 the cylinder prior"},
      p.prior_weight, 0.0, 1.0);
    v(
        ParameterInfo{
            "kernel_scale", "",
            "width of the radial basis functions, in mean distances between centres (Eq 19)"},
        p.kernel_scale, 0.1, 10.0);
    v(ParameterInfo{"ridge", "",
                    "regularisation of the interpolation system (Eq 21), relative to its diagonal"},
      p.ridge, 1e-9, 1.0);
    v(ParameterInfo{"max_centers", "",
                    "most interpolation centres a plant; more points are thinned to as many"},
      p.max_centers, 10, 2000);
    v(ParameterInfo{"max_gap", "m", "gaps along the stem longer than this stay open"}, p.max_gap,
      0.0, 2.0);
    v(ParameterInfo{"density", "1/m^2",
                    "surface density that gaps are filled to (N0 of Eq 22); 0: the stem's own "
                    "median, but at "
                    "least points_around"},
      p.density, 0.0, 1e7);
    v(
        ParameterInfo{
            "points_around", "",
            "points round the stem that gaps are filled to at least, as far apart along it; "
            "0: no more than density says"},
        p.points_around, 0, 200);
    v(ParameterInfo{"max_stddev", "m",
                    "surface that is known less well than this stays open, as where a stem is seen "
                    "from one side only"},
      p.max_stddev, 0.0, 1.0);
    v(ParameterInfo{"smoothing", "",
                    "sigma_s of the bilateral filter (Eq 25), share of the stem's radius; 0: off. "
                    "Traits are measured before it"},
      p.smoothing, 0.0, 0.3);
    v(ParameterInfo{"min_points", "", "stems with fewer measured points are left alone"},
      p.min_points, 4, 1000);
  }
};

/// Traits (paper 2.7, 2.8).
struct MeasurementParameters {
  std::string mode = "robust";
  double diameter_height = 0.7;
  double diameter_height_share = 0.4;
  double diameter_span = 0.9;
  double noise = 0.0;
  int min_points = 12;
  double min_arc = 0.33;
  double max_shift = 0.3;
  double ellipticity_prior = 0.05;
  bool block_shape_prior = true;
  bool block_diameter_prior = false;
  double min_quality = 0.3;

  template <class Self, class Visitor>
  static void visit(Self& p, Visitor&& v) {
    v(ParameterInfo{"mode", "",
                    "robust: noise-aware ellipse fit across the axis; paper: Eq 27 and the plain "
                    "maximum as printed"},
      p.mode, "robust", "paper");
    v(ParameterInfo{"diameter_height", "m",
                    "height above the soil at which the stem diameter is taken"},
      p.diameter_height, 0.01, 5.0);
    v(ParameterInfo{"diameter_height_share", "", "but never above this share of the stem's length"},
      p.diameter_height_share, 0.05, 1.0);
    v(ParameterInfo{"diameter_span", "m", "length of stem whose points are fitted"},
      p.diameter_span, 0.01, 1.0);
    v(
        ParameterInfo{
            "noise", "m",
            "standard deviation of a point across the stem; 0: estimated from the stem itself"},
        p.noise, 0.0, 0.1);
    v(ParameterInfo{"min_points", "", "fewest stem points for a diameter"}, p.min_points, 5, 10000);
    v(ParameterInfo{"min_arc", "",
                    "smallest share of the circumference seen; below it the diameter is flagged"},
      p.min_arc, 0.0, 1.0);
    v(ParameterInfo{"max_shift", "m",
                    "a diameter may be taken from points this much farther from the height asked "
                    "for where few are seen there"},
      p.max_shift, 0.0, 2.0);
    v(ParameterInfo{"ellipticity_prior", "",
                    "standard deviation of each component of (a - b) / (a + b) of a stem, before "
                    "its points "
                    "are looked at; 0: circles"},
      p.ellipticity_prior, 0.0, 1.0);
    v(ParameterInfo{"block_shape_prior", "",
                    "noise, taper and ellipticity of a stem are expected to be like those of the "
                    "block's other stems, its diameter to be within 20 % of theirs (one standard "
                    "deviation), and one quite unlike them is known less well (unlike_stand)"},
      p.block_shape_prior, false, true);
    v(ParameterInfo{"block_diameter_prior", "",
                    "its diameter is expected to be as like theirs as theirs are like each other, "
                    "which pulls diameters towards the block's mean: not for trials whose plots "
                    "differ; needs block_shape_prior"},
      p.block_diameter_prior, false, true);
    v(ParameterInfo{"min_quality", "",
                    "plants whose stem scores less (Q of Eq 9) are flagged low_confidence"},
      p.min_quality, 0.0, 1.0);
  }
};

/// All stages together, as `phenotype_cloud --config` reads them.
struct Parameters {
  PreprocessingParameters preprocessing;
  SegmentationParameters segmentation;
  CompletionParameters completion;
  MeasurementParameters measurement;

  /// Calls v(section name, section) for each stage.
  template <class Self, class SectionVisitor>
  static void visitSections(Self& p, SectionVisitor&& v) {
    v("preprocessing", p.preprocessing);
    v("segmentation", p.segmentation);
    v("completion", p.completion);
    v("measurement", p.measurement);
  }
};

/// Every violated range or cross-check within a stage, one a line ("segmentation/M: 1.3 is outside
/// 0.01 ... 1"); empty when all is well. For whoever knows the parameters of one stage only.
std::string checkStages(const Parameters& parameters);

/// The same, and what parameters of different stages must have to do with one another.
std::string checkParameters(const Parameters& parameters);

}  // namespace field_phenotyping
