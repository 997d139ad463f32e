#!/usr/bin/env bash
# Usage: fuzz_test.bash CLANG++ BUILD_DIR SECONDS
# Builds the fuzz target and runs it from the corpus, always with the same seed.
set -euo pipefail
source=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
compiler=$1
build=$2
seconds=$3

if ! echo 'extern "C" int LLVMFuzzerTestOneInput(const char*, unsigned long) { return 0; }' |
  "${compiler}" -fsanitize=fuzzer,address,undefined -x c++ - -o /dev/null 2>/dev/null; then
  echo "SKIPPED: ${compiler} cannot link libFuzzer (on Debian it is in libclang-rt-dev)"
  exit 0
fi
cmake -S "${source}" -B "${build}" -DCMAKE_CXX_COMPILER="${compiler}" \
  -DPYTHON_EXECUTABLE=/usr/bin/python3 >/dev/null
cmake --build "${build}"
rm -rf "${build}/found"
mkdir "${build}/found"
"${build}/fuzz_cloud_decoder" -seed=1 -max_total_time="${seconds}" -verbosity=0 \
  -artifact_prefix="${build}/" "${build}/found" "${source}/corpus"
