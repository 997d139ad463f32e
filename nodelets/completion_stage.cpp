#include "completion_stage.hpp"

#include <boost/make_shared.hpp>

#include "field_phenotyping/completion/completion.hpp"

namespace field_phenotyping {

CompletionStage::CompletionStage(ros::NodeHandle nh, ros::NodeHandle pnh, const std::string& name)
    : stage_(nh, pnh, name),
      done_(Stage::history(pnh)),
      completed_(stage_.privateHandle(), "completed", addSynthetic) {
  stage_.start([this](const auto& block, const auto& p) { return work(block, p); },
               [this] { completed_.update(done_); });
}

CompletionStage::~CompletionStage() {
  stage_.stop();
}

boost::shared_ptr<const CompletedBlock> CompletionStage::work(
    const boost::shared_ptr<const SegmentedBlock>& block, const CompletionParameters& parameters) {
  const auto completed =
      boost::make_shared<CompletedBlock>(completeBlock(toStd(block), parameters));
  stage_.health().show("plants in the last block", static_cast<double>(block->plants.size()));
  stage_.health().show("synthetic points in the last block",
                       static_cast<double>(completed->synthetic.size()));
  done_.add(completed);
  completed_.changed();
  return completed;
}

}  // namespace field_phenotyping
