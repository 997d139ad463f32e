#include <nodelet/nodelet.h>

#include <exception>
#include <memory>
#include <pluginlib/class_list_macros.hpp>

#include "bag_player.hpp"
#include "completion_stage.hpp"
#include "measurement_stage.hpp"
#include "preprocessing_stage.hpp"
#include "segmentation_stage.hpp"

namespace field_phenotyping {

/// A stage, or what plays to them, as a nodelet.
template <class Stage>
class StageNodelet : public nodelet::Nodelet {
 private:
  void onInit() override {
    try {
      stage_ = std::make_unique<Stage>(getNodeHandle(), getPrivateNodeHandle(), getName());
    } catch (const std::exception& error) {
      // An exception that leaves onInit() would end every nodelet of the manager.
      NODELET_FATAL_STREAM("not started: " << error.what());
    }
  }

  std::unique_ptr<Stage> stage_;
};

using BagPlayerNodelet = StageNodelet<BagPlayer>;
using PreprocessingNodelet = StageNodelet<PreprocessingStage>;
using SegmentationNodelet = StageNodelet<SegmentationStage>;
using CompletionNodelet = StageNodelet<CompletionStage>;
using MeasurementNodelet = StageNodelet<MeasurementStage>;

}  // namespace field_phenotyping

PLUGINLIB_EXPORT_CLASS(field_phenotyping::BagPlayerNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(field_phenotyping::PreprocessingNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(field_phenotyping::SegmentationNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(field_phenotyping::CompletionNodelet, nodelet::Nodelet)
PLUGINLIB_EXPORT_CLASS(field_phenotyping::MeasurementNodelet, nodelet::Nodelet)
