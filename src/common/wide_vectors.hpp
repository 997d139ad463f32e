#pragma once

namespace field_phenotyping {

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__CUDACC__)
/// work(), which the compiler copies into here, with the instructions that AVX2 adds.
template <class Work>
[[gnu::target("avx2"), gnu::flatten, gnu::noinline]] auto withAvx2(const Work& work) {
  return work();
}
#endif

/// work(), with wider vectors where the processor has them: the same operations in the same order
/// on the same numbers, thus the same bits. For loops over many numbers, not for each of them. What
/// work() calls gains only where its source is seen here.
template <class Work>
auto withWideVectors(const Work& work) {
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__CUDACC__)
  if (__builtin_cpu_supports("avx2") != 0) return withAvx2(work);
#endif
  return work();
}

}  // namespace field_phenotyping
