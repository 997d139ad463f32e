#pragma once

#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <memory>
#include <string>
#include <vector>

namespace field_phenotyping {

/// Bags that are read as one: `rosbag record --split` makes several of one drive.
class BagFiles {
 public:
  /// Opens them to be read.
  /// @param paths a bag; or a pattern, `drive_*.bag`; or a folder, all bags in it; or several of
  ///              these with spaces between. What `rosbag reindex` and `compress` have left,
  ///              `.orig.bag`, is only taken where it is named itself.
  /// @throws std::runtime_error naming the file, what is wrong with it, and the cure
  explicit BagFiles(const std::string& paths);

  /// Whose connections fulfil `wanted`, a predicate of const rosbag::ConnectionInfo*; of all bags,
  /// in the order of time.
  template <class Wanted>
  std::unique_ptr<rosbag::View> view(const Wanted& wanted) const {
    auto all = std::make_unique<rosbag::View>();
    for (const auto& bag : bags_) all->addQuery(*bag, wanted);
    return all;
  }
  std::unique_ptr<rosbag::View> view() const;

 private:
  std::vector<std::unique_ptr<rosbag::Bag>> bags_;
};

}  // namespace field_phenotyping
