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
  float decay;            // each number's gradient grows by decay times the number
  bool sparse;            // numbers whose gradient is 0 are left alone, moments and decay too
};

// Intervals along rays: density and rgb at [count, samples], interval ends tdist [count, samples + 1].
struct Rays {
  const float* density;
  const float* rgb;
  const float* tdist;
  int64_t count, samples;
};

struct CompositeOut {
  float *weights, *rgb, *opacity, *depth_sum;
};

struct CompositeGrad {
  const float *weights, *rgb, *opacity, *depth_sum;
};

// Two histograms for each ray: ends [rays, n + 1] and weights [rays, n]; m intervals in the other.
struct Histograms {
  const float *ends, *weights, *other_ends, *other_weights;
  int64_t rays, n, m;
};

// weights[l] is [width[l + 1], width[l]]. starts [rows / run, width[1]], or null: what the first layer's sums start from,
// a row for each `run` rows, at most kMostRun.
constexpr int64_t kMostRun = 192;
struct Network {
  int layers;
  const int64_t* width;  // [layers + 1]
  const float* const* weights;
  const float* starts;
  int64_t run;
};

struct NetworkGrad {
  float* const* weights;
  float* starts;
};

// What `count` points' colours are made of, [count, 3] each; specular may be null. Points come in runs, the last one maybe
// shorter, that share a row of exposure: log gain and offset of the three channels; null: as they are.
struct Logits {
  const float *diffuse, *specular, *exposure;
  int64_t count, run;
  bool shared;    // all runs have the first row of exposure, or none
  float scale;    // of the specular part
  float padding;  // by how much colours may pass [0, 1]
};

struct LogitsGrad {
  float *diffuse, *specular, *exposure;  // the last two may be null
};

// Densities in side^3 cells of a cube: the contracted ball's, or that of half side `bound`.
struct Cells {
  const float* density;
  int32_t side;
  bool contraction;
  float bound;
};

// Gaussians: means, logarithms of standard deviations and colours [count, 3], quaternions w x y z of any length
// [count, 4], logits of opacity [count].
struct Splats {
  const float *mean, *log_scale, *rotation, *opacity, *rgb;
  int64_t count;
};

struct SplatsGrad {
  float *mean, *log_scale, *rotation, *opacity, *rgb;
};

// Focal lengths and centre in pixels; what is nearer than `near` is not seen.
struct Pinhole {
  float fx, fy, cx, cy;
  int64_t width, height;
  float near;
  float cam_from_world[12];
};

struct Kernels {
  const char* name;
  void (*hash_forward)(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads);
  // Overwrites the levels' entries of table_grad.
  void (*hash_backward)(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad,
                        int threads);
  void (*mlp_forward)(const float* x, int64_t count, Network net, float* out, int threads);
  // x_grad may be null.
  void (*mlp_backward)(const float* x, int64_t count, Network net, const float* out_grad, float* x_grad,
                       NetworkGrad grad, int threads);
  void (*composite_forward)(Rays rays, CompositeOut out, int threads);
  void (*composite_backward)(Rays rays, const float* weights, CompositeGrad grad, float* density_grad,
                             float* rgb_grad, int threads);
  // rgb of both parts, and of the diffuse one alone.
  void (*colours_forward)(Logits in, float* rgb, float* diffuse_rgb, int threads);
  // Either gradient may be null: zero. That of exposure is added to what is there.
  void (*colours_backward)(Logits in, const float* rgb_grad, const float* diffuse_rgb_grad, LogitsGrad grad, int threads);
  // origins, directions [rays, 3]; tdist [bins + 1], every ray's; out [rays, bins].
  void (*grid_histogram)(Cells cells, const float* origins, const float* directions, int64_t rays, const float* tdist,
                         int64_t bins, float floor, float* out, int threads);
  // cube [count, 3], seen [count] >= 0.
  void (*grid_learn)(float* density, int32_t side, const float* cube, const float* seen, int64_t count, float memory);
  // sdist [rays, n + 1], weights [rays, n], jitter [rays, count] or null, out [rays, count + 1].
  void (*resample)(const float* sdist, const float* weights, int64_t rays, int64_t n, int64_t count,
                   const float* jitter, float* out, int threads);
  // Contracts space into the ball of radius 2, and that into [0, 1]^3; points and out are [count, 3].
  void (*unit_cube)(const float* points, int64_t count, float* out, int threads);
  // out, out_grad [rays]; grad [rays, m] is that of other_weights.
  void (*interlevel_forward)(Histograms h, float* out, int threads);
  void (*interlevel_backward)(Histograms h, const float* out_grad, float* grad, int threads);
  // Returns how many numbers it left alone, moments too, since their gradient is not finite.
  int64_t (*adam)(float* param, const float* grad, float* m, float* v, int64_t count, Adam adam, int threads);
  // rgb [height, width, 3], before black.
  void (*splats_forward)(Splats splats, Pinhole camera, float* rgb, int threads);
  // rgb is what splats_forward wrote. Gradients of what is not seen keep what they hold.
  void (*splats_backward)(Splats splats, Pinhole camera, const float* rgb, const float* rgb_grad, SplatsGrad grad,
                          int threads);
};

namespace portable { extern const Kernels kKernels; }
namespace avx2 { extern const Kernels kKernels; }
namespace avx512 { extern const Kernels kKernels; }

}  // namespace inpaint3d
