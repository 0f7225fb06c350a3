// What proposal sampling costs around its networks: points mapped to the grids' cube, and the loss that makes a proposal
// bound the field's histogram (Mip-NeRF 360, arXiv:2111.12077, eq. 10 and 13).
#include "cube.hpp"
#include "operations.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int64_t kPoints = 4096;  // points of one task
constexpr int64_t kRays = 128;     // rays of one task

template <class Range>
void for_each_range(int64_t count, int64_t share, int threads, const Range& range) {
  parallel_for((count + share - 1) / share, threads,
               [&](int64_t task) { range(task * share, count < (task + 1) * share ? count : (task + 1) * share); });
}

// The intervals [low, high) of the other histogram that overlap interval i. As i grows they only move on.
struct Overlap {
  const float *ends, *other_ends;
  int64_t m;
  int64_t low = 0, high = 0;
  void move_to(int64_t i) {
    while (low < m && other_ends[low + 1] <= ends[i]) ++low;
    while (high < m && other_ends[high] < ends[i + 1]) ++high;
  }
};

// reached[j] is the weight in front of end j.
inline void accumulate(const float* weights, int64_t count, float* reached) {
  double sum = 0.0;
  reached[0] = 0.0f;
  for (int64_t j = 0; j < count; ++j) reached[j + 1] = static_cast<float>(sum += weights[j]);
}

// By how much the bound of an interval's weight is too low.
inline float lacking(float weight, float bound) {
  const float gap = weight - (bound < 0.0f ? 0.0f : bound);
  return gap < 0.0f ? 0.0f : gap;
}

constexpr float kEps = 1.1920929e-7f;

}  // namespace

void unit_cube(const float* points, int64_t count, float* out, int threads) {
  for_each_range(count, kPoints, threads, [&](int64_t begin, int64_t end) {
#pragma GCC ivdep
    for (int64_t i = begin; i < end; ++i) {
      const float x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
      const float scale = contraction_scale(x, y, z);
      out[3 * i] = x * scale * 0.25f + 0.5f;
      out[3 * i + 1] = y * scale * 0.25f + 0.5f;
      out[3 * i + 2] = z * scale * 0.25f + 0.5f;
    }
  });
}

void interlevel_forward(Histograms h, float* out, int threads) {
  for_each_range(h.rays, kRays, threads, [&](int64_t begin, int64_t end) {
    float* reached = new float[h.m + 1];
    for (int64_t r = begin; r < end; ++r) {
      Overlap overlap{h.ends + r * (h.n + 1), h.other_ends + r * (h.m + 1), h.m};
      accumulate(h.other_weights + r * h.m, h.m, reached);
      float loss = 0.0f;
      for (int64_t i = 0; i < h.n; ++i) {
        overlap.move_to(i);
        const float weight = h.weights[r * h.n + i];
        const float gap = lacking(weight, reached[overlap.high] - reached[overlap.low]);
        loss += gap * gap / (weight + kEps);
      }
      out[r] = loss;
    }
    delete[] reached;
  });
}

void interlevel_backward(Histograms h, const float* out_grad, float* grad, int threads) {
  for_each_range(h.rays, kRays, threads, [&](int64_t begin, int64_t end) {
    float* reached = new float[h.m + 1];
    float* slope = new float[h.m + 1];  // the gradient of each of `reached`
    for (int64_t r = begin; r < end; ++r) {
      Overlap overlap{h.ends + r * (h.n + 1), h.other_ends + r * (h.m + 1), h.m};
      accumulate(h.other_weights + r * h.m, h.m, reached);
      for (int64_t j = 0; j <= h.m; ++j) slope[j] = 0.0f;
      for (int64_t i = 0; i < h.n; ++i) {
        overlap.move_to(i);
        const float weight = h.weights[r * h.n + i];
        const float gap = lacking(weight, reached[overlap.high] - reached[overlap.low]);
        const float push = -2.0f * out_grad[r] * gap / (weight + kEps);
        slope[overlap.high] += push;
        slope[overlap.low] -= push;
      }
      float behind = 0.0f;
      for (int64_t j = h.m - 1; j >= 0; --j) grad[r * h.m + j] = behind += slope[j + 1];
    }
    delete[] slope;
    delete[] reached;
  });
}

}  // namespace inpaint3d::INPAINT3D_ISA
