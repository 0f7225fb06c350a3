// Volume rendering along rays (NeRF, arXiv:2003.08934, eq. 3) with its adjoint, and inverse-CDF sampling of intervals.
#include "exponential.hpp"
#include "operations.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int kPiece = 64;       // intervals handled together; a multiple of every kLanes
constexpr int64_t kRays = 256;   // rays of one task

template <class Ray>
void for_each_ray(int64_t rays, int threads, const Ray& ray) {
  parallel_for((rays + kRays - 1) / kRays, threads, [&](int64_t block) {
    const int64_t end = rays < (block + 1) * kRays ? rays : (block + 1) * kRays;
    for (int64_t r = block * kRays; r < end; ++r) ray(r);
  });
}

struct Piece {
  alignas(64) float depth[kPiece];   // -optical depth of each interval
  alignas(64) float before[kPiece];  // -optical depth in front of it
};

// Fills the piece from interval `first`; returns the negative optical depth behind it.
inline float absorb(const float* density, const float* tdist, int64_t first, int count, float front, Piece& piece) {
  for (int i = 0; i < count; ++i)
    piece.depth[i] = -density[first + i] * (tdist[first + i + 1] - tdist[first + i]);
  for (int i = count; i < kPiece; ++i) piece.depth[i] = piece.before[i] = 0.0f;
  for (int i = 0; i < count; ++i) {
    piece.before[i] = front;
    front += piece.depth[i];
  }
  return front;
}

inline void composite_ray(const float* density, const float* rgb, const float* tdist, int64_t samples,
                          float* weights, float* rgb_out, float* opacity, float* depth_sum) {
  Piece piece;
  float front = 0.0f, total = 0.0f, distance = 0.0f, colour[3] = {};
  for (int64_t first = 0; first < samples; first += kPiece) {
    const int count = static_cast<int>(samples - first < kPiece ? samples - first : kPiece);
    front = absorb(density, tdist, first, count, front, piece);
    for (int i = 0; i < count; i += kLanes) {
      const Floats alpha = -exponential(load<Floats>(piece.depth + i)).expm1;
      store(piece.depth + i, alpha * exponential(load<Floats>(piece.before + i)).exp);
    }
    for (int i = 0; i < count; ++i) {
      const float weight = piece.depth[i];
      const int64_t at = first + i;
      weights[at] = weight;
      total += weight;
      distance += weight * 0.5f * (tdist[at + 1] + tdist[at]);
      for (int channel = 0; channel < 3; ++channel) colour[channel] += weight * rgb[3 * at + channel];
    }
  }
  *opacity = total;
  *depth_sum = distance;
  for (int channel = 0; channel < 3; ++channel) rgb_out[channel] = colour[channel];
}

// With G_i the gradient of weight w_i and T_i the light that reaches interval i, the optical depth's gradient is
// G_i T_(i+1) - sum over j > i of G_j w_j.
inline void composite_ray_adjoint(const float* density, const float* rgb, const float* tdist, const float* weights,
                                  int64_t samples, const float* weights_grad, const float* rgb_out_grad,
                                  float opacity_grad, float depth_grad, float* density_grad, float* rgb_grad) {
  Piece piece;
  float front = 0.0f;
  for (int64_t first = 0; first < samples; first += kPiece) {
    const int count = static_cast<int>(samples - first < kPiece ? samples - first : kPiece);
    front = absorb(density, tdist, first, count, front, piece);
    for (int i = 0; i < count; i += kLanes)
      store(piece.before + i, exponential(load<Floats>(piece.before + i) + load<Floats>(piece.depth + i)).exp);
    for (int i = 0; i < count; ++i) density_grad[first + i] = piece.before[i];
  }
  float behind = 0.0f;
  for (int64_t i = samples - 1; i >= 0; --i) {
    float grad = weights_grad[i] + opacity_grad + depth_grad * 0.5f * (tdist[i + 1] + tdist[i]);
    for (int channel = 0; channel < 3; ++channel) {
      grad += rgb_out_grad[channel] * rgb[3 * i + channel];
      rgb_grad[3 * i + channel] = rgb_out_grad[channel] * weights[i];
    }
    density_grad[i] = (grad * density_grad[i] - behind) * (tdist[i + 1] - tdist[i]);
    behind += grad * weights[i];
  }
}

// cdf has n + 1 numbers of scratch space.
inline void resample_ray(const float* sdist, const float* weights, int64_t n, int64_t count, const float* jitter,
                         float* cdf, float* out) {
  constexpr float kEps = 1.1920929e-7f;
  double mass = 0.0;
  cdf[0] = 0.0f;
  for (int64_t i = 0; i < n; ++i) {
    mass += weights[i] + kEps * (sdist[i + 1] - sdist[i]);
    cdf[i + 1] = static_cast<float>(mass);
  }
  const float total = cdf[n];
  if (!(total - total == 0.0f)) {  // a histogram that is not finite has no quantiles
    for (int64_t k = 0; k <= count; ++k) out[k] = __builtin_nanf("");
    return;
  }
  for (int64_t i = 1; i <= n; ++i) cdf[i] /= total;
  int64_t right = 1;
  float first = 0.0f, before = 0.0f, centre = 0.0f;
  for (int64_t k = 0; k < count; ++k) {
    const float u = (static_cast<float>(k) + (jitter ? jitter[k] : 0.5f)) / static_cast<float>(count);
    while (right < n && cdf[right] <= u) ++right;
    while (right > 1 && cdf[right - 1] > u) --right;  // only a jitter outside [0, 1) comes here
    const float gap = cdf[right] - cdf[right - 1];
    float share = (u - cdf[right - 1]) / (gap > 0.0f ? gap : 1.0f);
    share = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
    before = centre;
    centre = sdist[right - 1] + share * (sdist[right] - sdist[right - 1]);
    if (k == 0)
      first = centre;
    else
      out[k] = 0.5f * (centre + before);
  }
  const float low = 2.0f * first - out[1], high = 2.0f * centre - out[count - 1];
  out[0] = low < sdist[0] ? sdist[0] : low;
  out[count] = high > sdist[n] ? sdist[n] : high;
}

}  // namespace

void composite_forward(Rays rays, CompositeOut out, int threads) {
  const int64_t s = rays.samples;
  for_each_ray(rays.count, threads, [&](int64_t r) {
    composite_ray(rays.density + r * s, rays.rgb + 3 * r * s, rays.tdist + r * (s + 1), s, out.weights + r * s,
                  out.rgb + 3 * r, out.opacity + r, out.depth_sum + r);
  });
}

void composite_backward(Rays rays, const float* weights, CompositeGrad grad, float* density_grad, float* rgb_grad,
                        int threads) {
  const int64_t s = rays.samples;
  for_each_ray(rays.count, threads, [&](int64_t r) {
    composite_ray_adjoint(rays.density + r * s, rays.rgb + 3 * r * s, rays.tdist + r * (s + 1), weights + r * s, s,
                          grad.weights + r * s, grad.rgb + 3 * r, grad.opacity[r], grad.depth_sum[r],
                          density_grad + r * s, rgb_grad + 3 * r * s);
  });
}

void resample(const float* sdist, const float* weights, int64_t rays, int64_t n, int64_t count, const float* jitter,
              float* out, int threads) {
  parallel_for((rays + kRays - 1) / kRays, threads, [&](int64_t block) {
    float* cdf = new float[n + 1];
    const int64_t end = rays < (block + 1) * kRays ? rays : (block + 1) * kRays;
    for (int64_t r = block * kRays; r < end; ++r)
      resample_ray(sdist + r * (n + 1), weights + r * n, n, count, jitter ? jitter + r * count : nullptr, cdf,
                   out + r * (count + 1));
    delete[] cdf;
  });
}

}  // namespace inpaint3d::INPAINT3D_ISA
