#include "bag_files.hpp"

#include <glob.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <stdexcept>

namespace field_phenotyping {
namespace {

namespace fs = std::filesystem;

bool endsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

bool isLeftOver(const std::string& path) {
  return endsWith(path, ".orig.bag");
}

std::vector<std::string> bagsIn(const std::string& folder) {
  std::vector<std::string> bags;
  bool unfinished = false;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string path = entry.path().string();
    if (endsWith(path, ".bag") && !isLeftOver(path)) bags.push_back(path);
    unfinished = unfinished || endsWith(path, ".bag.active");
  }
  if (fs::exists(fs::path(folder) / "metadata.yaml") && bags.empty()) {
    throw std::runtime_error("the folder '" + folder +
                             "' is a bag of ROS 2, which cannot be read here: `rosbags-convert` "
                             "(pip install rosbags) makes a ROS 1 bag of it");
  }
  if (bags.empty() && unfinished) {
    throw std::runtime_error("the folder '" + folder +
                             "' holds only .bag.active, whose recording was cut off or is still "
                             "going on. Cure: `rosbag reindex FILE.bag.active`, then rename it "
                             "to .bag");
  }
  return bags;
}

std::vector<std::string> matching(const std::string& pattern) {
  if (fs::is_directory(pattern)) return bagsIn(pattern);
  if (fs::exists(pattern)) return {pattern};
  glob_t found = {};
  std::vector<std::string> bags;
  if (::glob(pattern.c_str(), GLOB_TILDE, nullptr, &found) == 0) {
    for (std::size_t k = 0; k < found.gl_pathc; ++k) {
      const std::string path = found.gl_pathv[k];
      if (!isLeftOver(path)) bags.push_back(path);
    }
  }
  ::globfree(&found);
  return bags;
}

std::vector<std::string> pathsOf(const std::string& paths) {
  if (fs::exists(paths)) return matching(paths);  // whatever spaces are in its name
  std::set<std::string> all;
  std::istringstream words(paths);
  for (std::string word; words >> word;) {
    const std::vector<std::string> some = matching(word);
    if (some.empty()) {
      throw std::runtime_error("the bag '" + word +
                               "' cannot be read: there is no such file. Give absolute paths");
    }
    all.insert(some.begin(), some.end());
  }
  return {all.begin(), all.end()};
}

/// Why a file cannot be read, and what to do.
std::string whyNot(const std::string& path, const std::string& said) {
  std::array<char, 16> begin = {};
  std::ifstream(path, std::ios::binary).read(begin.data(), begin.size() - 1U);
  const std::string magic = begin.data();
  const std::string what = "the bag '" + path + "' cannot be read: ";
  if (magic.rfind("#ROSBAG V", 0) == 0) {
    return what + "it has no index, for its recording was cut off (" + said +
           "). Cure: `rosbag reindex " + path + "` keeps what is in it" +
           (endsWith(path, ".active") ? "; then rename it to .bag" : "");
  }
  if (magic.rfind("SQLite format", 0) == 0 || magic.find("MCAP") != std::string::npos) {
    return what +
           "it is one of ROS 2. Cure: `rosbags-convert` (pip install rosbags) makes a ROS "
           "1 bag of it";
  }
  if (std::error_code error; fs::file_size(path, error) == 0U && !error) {
    return what + "it is empty: recording ended before anything was written. Record again";
  }
  return what + "it is no ROS 1 bag (" + said + ")";
}

}  // namespace

BagFiles::BagFiles(const std::string& paths) {
  const std::vector<std::string> files = pathsOf(paths);
  if (files.empty()) throw std::runtime_error("there is no bag in '" + paths + "'");
  for (const std::string& file : files) {
    auto bag = std::make_unique<rosbag::Bag>();
    try {
      bag->open(file, rosbag::bagmode::Read);
    } catch (const rosbag::BagException& error) {
      throw std::runtime_error(whyNot(file, error.what()));
    }
    bags_.push_back(std::move(bag));
  }
}

std::unique_ptr<rosbag::View> BagFiles::view() const {
  return view([](const rosbag::ConnectionInfo*) { return true; });
}

}  // namespace field_phenotyping
