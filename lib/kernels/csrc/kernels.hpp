// The kernels as one table of functions for each instruction set.
//
// All arrays are contiguous float32 in C order. Results have the same bits for any number of threads: work is split so
// that each output number is summed by one task in a fixed order, and no kernel uses atomics.
#pragma once

#include <cstdint>

namespace inpaint3d {

// One resolution of a hash grid. `offset` and `size` count table entries.
struct Level {
  int32_t resolution;
  uint32_t size;
  int64_t offset;
  bool dense;
};

struct Grid {
  const Level* levels;
  int level_count;
  int channels;
};

struct Adam {
  float step_size;        // learning rate / (1 - beta1^step)
  float inverse_spread;   // 1 / sqrt(1 - beta2^step)
  float beta1, beta2, eps;
};

struct Kernels {
  const char* name;
  void (*hash_forward)(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads);
  // Adds to table_grad.
  void (*hash_backward)(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad,
                        int threads);
  void (*adam)(float* param, const float* grad, float* m, float* v, int64_t count, Adam adam, int threads);
};

namespace portable { extern const Kernels kKernels; }
namespace avx2 { extern const Kernels kKernels; }
namespace avx512 { extern const Kernels kKernels; }

}  // namespace inpaint3d
