#include "rows_file.hpp"

#include <fstream>
#include <stdexcept>

namespace field_phenotyping::benchmark {

void writeRows(const nlohmann::json& rows, const std::string& path) {
  std::ofstream file(path);
  file << rows.dump(1) << "\n";
  if (!file.flush()) {
    throw std::runtime_error(path +
                             " cannot be written; is the disk full or the folder read-only?");
  }
}

}  // namespace field_phenotyping::benchmark
