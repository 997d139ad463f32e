// Says what is wrong with a bag, before it is replayed.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bag_check.hpp"
#include "config_file.hpp"

namespace {

using field_phenotyping::BagReport;
using field_phenotyping::Finding;
using field_phenotyping::Severity;

constexpr int kNothingWrong = 0;
constexpr int kSomethingWrong = 1;
constexpr int kUnusable = 2;

int statusOf(const BagReport& report) {
  int status = kNothingWrong;
  for (const Finding& finding : report.findings) {
    status = std::max(status, finding.severity == Severity::kError ? kUnusable : kSomethingWrong);
  }
  return status;
}

const char* nameOf(Severity severity) {
  return severity == Severity::kError ? "error" : "warning";
}

void print(const BagReport& report) {
  if (!report.points_topic.empty() && report.scans > 0U) {
    std::printf("%s: %zu scans in %.1f s, %.3g a second, %.0f points each, %.0f %% not finite\n",
                report.points_topic.c_str(), report.scans, report.duration_s, report.rate_hz,
                report.points_per_scan, 100.0 * report.non_finite_share);
    if (report.registered) {
      std::printf("frames: %s, registered already\n", report.sensor_frame.c_str());
    } else {
      std::printf("frames:");
      for (const std::string& frame : report.tf_chain) std::printf(" %s", frame.c_str());
      std::printf("%s; %zu of %zu scans placed, longest gap %.3g s, transforms up to %.2g s late\n",
                  report.tf_chain.empty() ? " not connected" : "", report.scans_placed,
                  report.scans, report.longest_tf_gap_s, report.latest_tf_s);
    }
    if (report.area_m2 > 0.0)
      std::printf(
          "density: %.0f points per square metre at stem height, plants of %.1f m on %.1f m^2\n",
          report.density, report.plant_height, report.area_m2);
  }
  for (const Finding& finding : report.findings) {
    std::printf("\n%s, %s: %s\n  cure: %s\n", nameOf(finding.severity), finding.about.c_str(),
                finding.what.c_str(), finding.cure.c_str());
  }
  if (report.findings.empty()) std::printf("nothing wrong was found\n");
}

nlohmann::json toJson(const std::string& bag, const BagReport& report) {
  nlohmann::json findings = nlohmann::json::array();
  for (const Finding& finding : report.findings) {
    findings.push_back({{"severity", nameOf(finding.severity)},
                        {"about", finding.about},
                        {"what", finding.what},
                        {"cure", finding.cure}});
  }
  return {{"bag", bag},
          {"status", statusOf(report)},
          {"points_topic", report.points_topic},
          {"scans", report.scans},
          {"duration_s", report.duration_s},
          {"rate_hz", report.rate_hz},
          {"points_per_scan", report.points_per_scan},
          {"non_finite_share", report.non_finite_share},
          {"sensor_frame", report.sensor_frame},
          {"registered", report.registered},
          {"scans_placed", report.scans_placed},
          {"tf_chain", report.tf_chain},
          {"longest_tf_gap_s", report.longest_tf_gap_s},
          {"latest_tf_s", report.latest_tf_s},
          {"density_per_m2", report.density},
          {"plant_height_m", report.plant_height},
          {"area_m2", report.area_m2},
          {"soil_share", report.soil_share},
          {"findings", findings}};
}

}  // namespace

int main(int argc, char** argv) {
  field_phenotyping::BagCheckRequest request;
  bool json = false;
  std::string config;
  std::vector<std::string> assignments;
  CLI::App app(
      "Says what is wrong with a bag, and what to do: topics, fields, frames, gaps in tf, time, "
      "points,\n"
      "and whether they are dense enough at stem height to measure diameters.");
  std::vector<std::string> bags;
  app.add_option("bag", bags,
                 "ROS 1 bag with the scans and, for raw scans, tf; or the bags that it was split "
                 "into, a pattern in quotes, or the folder that they are in")
      ->required();
  app.add_option("--points-topic", request.points_topic,
                 "Topic of the scans; if not given, the PointCloud2 with the most messages");
  app.add_option("--target-frame", request.target_frame, "Frame of all results, z up")
      ->capture_default_str();
  app.add_option("--config", config, "YAML file of parameters, as of the nodelets");
  app.add_option("--set", assignments, "Set one parameter: stage/parameter=value");
  app.add_flag("--json", json, "Print JSON instead of text");
  app.footer(
      "Exit status: 0 nothing wrong; 1 plants can be measured, but see what is said; 2 nothing "
      "right\n"
      "will be measured, or this is no bag");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kNothingWrong : kUnusable;
  }
  try {
    if (!config.empty()) field_phenotyping::readConfigFile(config, request.parameters);
    field_phenotyping::setParameters(assignments, request.parameters);
    for (const std::string& bag : bags) request.bag += (request.bag.empty() ? "" : " ") + bag;
    const BagReport report = field_phenotyping::checkBag(request);
    if (json) {
      std::cout << toJson(request.bag, report).dump(2) << "\n";
    } else {
      print(report);
    }
    return statusOf(report);
  } catch (const std::exception& error) {
    std::cerr << "check_bag: " << error.what() << "\n";
    return kUnusable;
  }
}
