// Adam (arXiv:1412.6980, algorithm 1) in one pass over param, grad, m and v.
#include "operations.hpp"
#include "parallel.hpp"
#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int64_t kBlock = 1 << 16;  // numbers of one task
constexpr float kLargest = 1.84467429e19f;  // its square is the first that float32 does not hold, or nearly
constexpr int64_t kGroup = 16;       // numbers that a sparse step looks at together: often none of them moves

struct State {
  float* param;
  const float* grad;
  float *m, *v;
};

inline bool all_rest(const float* grad, int64_t begin, int64_t end) {
  bool rest = true;
  for (int64_t i = begin; i < end; ++i) rest &= grad[i] == 0.0f;
  return rest;
}

// Moves numbers [begin, end); returns how many were left alone since the step would not leave them finite: the gradient
// is not, or its square overflows, which would stop the number for good, or the number or its moments are not.
template <bool sparse>
inline int32_t move(const State& state, const Adam& a, int64_t begin, int64_t end) {
  int32_t lost = 0;
#pragma GCC ivdep
  for (int64_t i = begin; i < end; ++i) {
    const float grad = state.grad[i], param = state.param[i], m = state.m[i], v = state.v[i];
    const float slope = grad + a.decay * param;
    const float first = m + (1.0f - a.beta1) * (slope - m);
    const float second = a.beta2 * v + (1.0f - a.beta2) * slope * slope;
    const float to = param - a.step_size * first / (__builtin_sqrtf(second) * a.inverse_spread + a.eps);
    const bool wanted = !sparse | (grad != 0.0f);
    // No short circuit: a branch would keep the loop from being one of vectors.
    const bool finite = (__builtin_fabsf(slope) < kLargest) & (second - second == 0.0f) & (to - to == 0.0f);
    const bool moves = wanted & finite;
    state.m[i] = moves ? first : m;
    state.v[i] = moves ? second : v;
    state.param[i] = moves ? to : param;
    lost += wanted & !finite;
  }
  return lost;
}

}  // namespace

int64_t adam(float* param, const float* grad, float* m, float* v, int64_t count, Adam adam, int threads) {
  const State state{param, grad, m, v};
  const int64_t blocks = (count + kBlock - 1) / kBlock;
  int64_t* lost = new int64_t[blocks]();
  parallel_for(blocks, threads, [&](int64_t block) {
    const FlushDenormals flush;
    const Adam a = adam;
    const int64_t end = count < (block + 1) * kBlock ? count : (block + 1) * kBlock;
    if (!a.sparse) {
      lost[block] = move<false>(state, a, block * kBlock, end);
      return;
    }
    for (int64_t i = block * kBlock; i < end; i += kGroup) {
      const int64_t last = end - i < kGroup ? end : i + kGroup;
      if (!all_rest(grad, i, last)) lost[block] += move<true>(state, a, i, last);
    }
  });
  int64_t sum = 0;
  for (int64_t block = 0; block < blocks; ++block) sum += lost[block];
  delete[] lost;
  return sum;
}

}  // namespace inpaint3d::INPAINT3D_ISA
