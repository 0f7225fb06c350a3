// Adam (arXiv:1412.6980, algorithm 1) in one pass over param, grad, m and v.
#include "operations.hpp"
#include "parallel.hpp"
#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {

void adam(float* param, const float* grad, float* m, float* v, int64_t count, Adam adam, int threads) {
  constexpr int64_t kBlock = 1 << 16;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](int64_t block) {
    const FlushDenormals flush;
    const int64_t end = count < (block + 1) * kBlock ? count : (block + 1) * kBlock;
    const Adam a = adam;
#pragma GCC ivdep
    for (int64_t i = block * kBlock; i < end; ++i) {
      const float slope = grad[i] + a.decay * param[i];
      const float first = m[i] + (1.0f - a.beta1) * (slope - m[i]);
      const float second = a.beta2 * v[i] + (1.0f - a.beta2) * slope * slope;
      m[i] = first;
      v[i] = second;
      param[i] -= a.step_size * first / (__builtin_sqrtf(second) * a.inverse_spread + a.eps);
    }
  });
}

}  // namespace inpaint3d::INPAINT3D_ISA
