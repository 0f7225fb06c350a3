// Splits tasks over threads. With no OpenMP in the build everything runs on the calling thread.
#pragma once

#include <cstdint>

#ifndef INPAINT3D_ISA
#define INPAINT3D_ISA portable
#endif

namespace inpaint3d::INPAINT3D_ISA {

// Calls task(i) for each i < count, in any order, on at most `threads` threads.
template <class Task>
inline void parallel_for(int64_t count, int threads, const Task& task) {
#if defined(_OPENMP)
  if (threads > 1 && count > 1) {
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int64_t i = 0; i < count; ++i) task(i);
    return;
  }
#endif
  (void)threads;
  for (int64_t i = 0; i < count; ++i) task(i);
}

}  // namespace inpaint3d::INPAINT3D_ISA
