// Python bindings: every shape and index is checked here, so that the kernels need not.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "dispatch.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace inpaint3d {
namespace {

template <class... Shape>
using In = nb::ndarray<const float, nb::device::cpu, nb::c_contig, Shape...>;
template <class... Shape>
using Out = nb::ndarray<float, nb::device::cpu, nb::c_contig, Shape...>;
using LevelTuple = std::tuple<int64_t, int64_t, int64_t, bool>;
// The named tuples of arguments.py, field by field.
using NetworkTuple = std::tuple<In<nb::ndim<2>>, std::vector<In<nb::ndim<2>>>, std::optional<In<nb::ndim<2>>>>;
using NetworkGradTuple =
    std::tuple<std::optional<Out<nb::ndim<2>>>, std::vector<Out<nb::ndim<2>>>, std::optional<Out<nb::ndim<2>>>>;
using SamplesTuple = std::tuple<In<nb::ndim<2>>, In<nb::shape<-1, -1, 3>>, In<nb::ndim<2>>>;
using SamplesGradTuple = std::tuple<Out<nb::ndim<2>>, Out<nb::shape<-1, -1, 3>>>;
using RenderedTuple = std::tuple<Out<nb::ndim<2>>, Out<nb::ndim<2>>, Out<nb::ndim<1>>, Out<nb::ndim<1>>>;
using RenderedGradTuple = std::tuple<In<nb::ndim<2>>, In<nb::ndim<2>>, In<nb::ndim<1>>, In<nb::ndim<1>>>;
using LogitsTuple =
    std::tuple<In<nb::shape<-1, 3>>, std::optional<In<nb::shape<-1, 3>>>, std::optional<In<nb::shape<-1, 6>>>>;
using LogitsGradTuple =
    std::tuple<Out<nb::shape<-1, 3>>, std::optional<Out<nb::shape<-1, 3>>>, std::optional<Out<nb::shape<-1, 6>>>>;
using ColourMapTuple = std::tuple<float, float>;
using ColoursTuple = std::tuple<Out<nb::shape<-1, 3>>, Out<nb::shape<-1, 3>>>;
using ColoursGradTuple = std::tuple<std::optional<In<nb::shape<-1, 3>>>, std::optional<In<nb::shape<-1, 3>>>>;
using CellsTuple = std::tuple<In<nb::ndim<1>>, int64_t, std::optional<float>>;
using RaysTuple = std::tuple<In<nb::shape<-1, 3>>, In<nb::shape<-1, 3>>, In<nb::ndim<1>>>;
using HistogramTuple = std::tuple<In<nb::ndim<2>>, In<nb::ndim<2>>>;
using SplatsTuple = std::tuple<In<nb::shape<-1, 3>>, In<nb::shape<-1, 3>>, In<nb::shape<-1, 4>>, In<nb::ndim<1>>, In<nb::shape<-1, 3>>>;
using SplatsGradTuple =
    std::tuple<Out<nb::shape<-1, 3>>, Out<nb::shape<-1, 3>>, Out<nb::shape<-1, 4>>, Out<nb::ndim<1>>, Out<nb::shape<-1, 3>>>;
using PinholeTuple = std::tuple<std::tuple<float, float, float, float>, In<nb::shape<3, 4>>, float>;
using AdamTuple = std::tuple<int64_t, double, double, double, double, double, bool>;

void require(bool truth, const std::string& message) {
  if (!truth) throw std::invalid_argument(message);
}

std::vector<Level> checked_levels(const std::vector<LevelTuple>& tuples, int64_t entries) {
  std::vector<Level> levels;
  for (const auto& [resolution, offset, size, dense] : tuples) {
    require(resolution >= 1 && resolution < (1 << 24), "a level's resolution must be in 1 .. 2^24 - 1, not " + std::to_string(resolution));
    require(size >= 1 && size <= INT32_MAX, "a level's size must be in 1 .. 2^31 - 1, not " + std::to_string(size));
    const double vertices = std::pow(static_cast<double>(resolution + 1), 3);
    if (dense)
      require(static_cast<double>(size) >= vertices, "a dense level of resolution " + std::to_string(resolution) + " needs (resolution + 1)^3 entries, not " + std::to_string(size));
    else
      require((size & (size - 1)) == 0, "a hashed level's size must be a power of two, not " + std::to_string(size));
    require(offset >= 0 && offset + size <= entries, "a level ends at entry " + std::to_string(offset + size) + " of a table of " + std::to_string(entries));
    for (const Level& other : levels)
      require(offset >= other.offset + int64_t{other.size} || offset + size <= other.offset, "two levels share entries of the table");
    levels.push_back({static_cast<int32_t>(resolution), static_cast<uint32_t>(size), offset, dense});
  }
  return levels;
}

Grid checked_grid(const std::vector<Level>& levels, size_t channels, size_t width) {
  require(channels >= 1 && channels <= 8, "a table has 1 to 8 channels, not " + std::to_string(channels));
  require(width == levels.size() * channels, "the features are " + std::to_string(width) + " wide, not levels x channels = " + std::to_string(levels.size() * channels));
  return {levels.data(), static_cast<int>(levels.size()), static_cast<int>(channels)};
}

void check_rows(size_t points, size_t rows) {
  require(points == rows, std::to_string(points) + " points but " + std::to_string(rows) + " rows of features");
}

template <class Array>
void require_shape(const Array& array, std::vector<int64_t> shape, const char* name) {
  bool same = array.ndim() == shape.size();
  for (size_t i = 0; same && i < shape.size(); ++i) same = static_cast<int64_t>(array.shape(i)) == shape[i];
  require(same, std::string(name) + " has the wrong shape");
}

void check_threads(int threads) {
  require(threads >= 1, "threads must be at least 1, not " + std::to_string(threads));
}

void hash_forward(In<nb::shape<-1, 3>> points, In<nb::ndim<2>> table, const std::vector<LevelTuple>& levels,
                  Out<nb::ndim<2>> out, int threads) {
  const auto laid_out = checked_levels(levels, static_cast<int64_t>(table.shape(0)));
  const Grid grid = checked_grid(laid_out, table.shape(1), out.shape(1));
  check_rows(points.shape(0), out.shape(0));
  const auto run = active().hash_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(points.data(), static_cast<int64_t>(points.shape(0)), table.data(), grid, out.data(), threads);
}

void hash_backward(In<nb::shape<-1, 3>> points, In<nb::ndim<2>> out_grad, const std::vector<LevelTuple>& levels,
                   Out<nb::ndim<2>> table_grad, int threads) {
  const auto laid_out = checked_levels(levels, static_cast<int64_t>(table_grad.shape(0)));
  const Grid grid = checked_grid(laid_out, table_grad.shape(1), out_grad.shape(1));
  check_rows(points.shape(0), out_grad.shape(0));
  const auto run = active().hash_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(points.data(), static_cast<int64_t>(points.shape(0)), out_grad.data(), grid, table_grad.data(), threads);
}

// A network's arrays, checked, as the kernels take them.
struct CheckedNetwork {
  std::vector<int64_t> width;
  std::vector<const float*> weights;
  const float* starts = nullptr;
  int64_t run = 1;

  CheckedNetwork(const In<nb::ndim<2>>& x, const std::vector<In<nb::ndim<2>>>& w,
                 const std::optional<In<nb::ndim<2>>>& first) {
    require(!w.empty(), "a network has at least one layer");
    width.push_back(static_cast<int64_t>(x.shape(1)));
    for (size_t layer = 0; layer < w.size(); ++layer) {
      const std::string name = "layer " + std::to_string(layer);
      require(static_cast<int64_t>(w[layer].shape(1)) == width.back(), name + " takes " + std::to_string(w[layer].shape(1)) + " numbers but is given " + std::to_string(width.back()));
      require(w[layer].shape(0) >= 1 && w[layer].shape(1) >= 1, name + " is empty");
      width.push_back(static_cast<int64_t>(w[layer].shape(0)));
      weights.push_back(w[layer].data());
    }
    if (!first) return;
    const auto rows = static_cast<int64_t>(x.shape(0)), runs = static_cast<int64_t>(first->shape(0));
    require(static_cast<int64_t>(first->shape(1)) == width[1], "starts must be as wide as the first layer");
    require(runs == 0 ? rows == 0 : rows % runs == 0, std::to_string(runs) + " starts do not divide " + std::to_string(rows) + " rows");
    if (rows == 0) return;
    run = rows / runs;
    require(run <= kMostRun, "runs of " + std::to_string(run) + " rows; at most " + std::to_string(kMostRun) + " share a start");
    starts = first->data();
  }

  Network network() const { return {static_cast<int>(weights.size()), width.data(), weights.data(), starts, run}; }
};

void mlp_forward(const NetworkTuple& network, Out<nb::ndim<2>> out, int threads) {
  const auto& [x, weights, starts] = network;
  const CheckedNetwork net(x, weights, starts);
  require(out.shape(0) == x.shape(0) && static_cast<int64_t>(out.shape(1)) == net.width.back(), "out must be [rows of x, width of the last layer]");
  const auto run = active().mlp_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(x.data(), static_cast<int64_t>(x.shape(0)), net.network(), out.data(), threads);
}

void mlp_backward(const NetworkTuple& network, In<nb::ndim<2>> out_grad, const NetworkGradTuple& grads, int threads) {
  const auto& [x, weights, starts] = network;
  const auto& [x_grad, weight_grads, starts_grad] = grads;
  const CheckedNetwork net(x, weights, starts);
  require(out_grad.shape(0) == x.shape(0) && static_cast<int64_t>(out_grad.shape(1)) == net.width.back(), "out_grad must be [rows of x, width of the last layer]");
  require(!x_grad || (x_grad->shape(0) == x.shape(0) && x_grad->shape(1) == x.shape(1)), "x_grad must have the shape of x");
  require(weight_grads.size() == weights.size(), "one gradient for each weight");
  std::vector<float*> weight_data;
  for (size_t layer = 0; layer < weights.size(); ++layer) {
    require(weight_grads[layer].shape(0) == weights[layer].shape(0) && weight_grads[layer].shape(1) == weights[layer].shape(1), "a weight's gradient must have its shape");
    weight_data.push_back(weight_grads[layer].data());
  }
  require(starts.has_value() == starts_grad.has_value(), "starts_grad is for starts");
  if (starts) require_shape(*starts_grad, {static_cast<int64_t>(starts->shape(0)), static_cast<int64_t>(starts->shape(1))}, "starts_grad");
  const auto run = active().mlp_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(x.data(), static_cast<int64_t>(x.shape(0)), net.network(), out_grad.data(), x_grad ? x_grad->data() : nullptr,
      {weight_data.data(), starts_grad ? starts_grad->data() : nullptr}, threads);
}

Rays checked_rays(const SamplesTuple& given) {
  const auto& [density, rgb, tdist] = given;
  const size_t rays = density.shape(0), samples = density.shape(1);
  require(rgb.shape(0) == rays && rgb.shape(1) == samples, "rgb must be [rays, samples, 3]");
  require(tdist.shape(0) == rays && tdist.shape(1) == samples + 1, "tdist must be [rays, samples + 1]");
  return {density.data(), rgb.data(), tdist.data(), static_cast<int64_t>(rays), static_cast<int64_t>(samples)};
}

void composite_forward(const SamplesTuple& samples, const RenderedTuple& out, int threads) {
  const auto& [weights, rgb_out, opacity, depth_sum] = out;
  const Rays rays = checked_rays(samples);
  require_shape(weights, {rays.count, rays.samples}, "weights");
  require_shape(rgb_out, {rays.count, 3}, "rgb_out");
  require_shape(opacity, {rays.count}, "opacity");
  require_shape(depth_sum, {rays.count}, "depth_sum");
  const auto run = active().composite_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(rays, {weights.data(), rgb_out.data(), opacity.data(), depth_sum.data()}, threads);
}

void composite_backward(const SamplesTuple& samples, In<nb::ndim<2>> weights, const RenderedGradTuple& out_grads,
                        const SamplesGradTuple& grads, int threads) {
  const auto& [weights_grad, rgb_out_grad, opacity_grad, depth_sum_grad] = out_grads;
  const auto& [density_grad, rgb_grad] = grads;
  const Rays rays = checked_rays(samples);
  require_shape(weights, {rays.count, rays.samples}, "weights");
  require_shape(weights_grad, {rays.count, rays.samples}, "weights_grad");
  require_shape(rgb_out_grad, {rays.count, 3}, "rgb_out_grad");
  require_shape(opacity_grad, {rays.count}, "opacity_grad");
  require_shape(depth_sum_grad, {rays.count}, "depth_sum_grad");
  require_shape(density_grad, {rays.count, rays.samples}, "density_grad");
  require_shape(rgb_grad, {rays.count, rays.samples, 3}, "rgb_grad");
  const auto run = active().composite_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(rays, weights.data(), {weights_grad.data(), rgb_out_grad.data(), opacity_grad.data(), depth_sum_grad.data()},
      density_grad.data(), rgb_grad.data(), threads);
}

constexpr int64_t kSharedRun = 1024;  // points with one exposure come in runs too, that threads have something to share

Logits checked_logits(const LogitsTuple& logits, const ColourMapTuple& colour_map) {
  const auto& [diffuse, specular, exposure] = logits;
  const auto [scale, padding] = colour_map;
  const auto count = static_cast<int64_t>(diffuse.shape(0));
  if (specular) require_shape(*specular, {count, 3}, "specular");
  const int64_t rows = exposure ? static_cast<int64_t>(exposure->shape(0)) : 1;
  require(rows > 0 ? count % rows == 0 : count == 0, std::to_string(rows) + " exposures do not divide " + std::to_string(count) + " points");
  const bool shared = rows == 1;
  return {diffuse.data(), specular ? specular->data() : nullptr, exposure ? exposure->data() : nullptr, count,
          shared || rows == 0 ? kSharedRun : count / rows, shared, scale, padding};
}

void colours_forward(const LogitsTuple& logits, const ColourMapTuple& colour_map, const ColoursTuple& out, int threads) {
  const auto& [rgb, diffuse_rgb] = out;
  const Logits in = checked_logits(logits, colour_map);
  require_shape(rgb, {in.count, 3}, "rgb");
  require_shape(diffuse_rgb, {in.count, 3}, "diffuse_rgb");
  const auto run = active().colours_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(in, rgb.data(), diffuse_rgb.data(), threads);
}

void colours_backward(const LogitsTuple& logits, const ColourMapTuple& colour_map, const ColoursGradTuple& out_grads,
                      const LogitsGradTuple& grads, int threads) {
  const auto& [diffuse, specular, exposure] = logits;
  const auto& [rgb_grad, diffuse_rgb_grad] = out_grads;
  const auto& [diffuse_grad, specular_grad, exposure_grad] = grads;
  Logits in = checked_logits(logits, colour_map);
  if (exposure && in.shared) in.run = in.count;  // its gradient is one sum
  if (rgb_grad) require_shape(*rgb_grad, {in.count, 3}, "rgb_grad");
  if (diffuse_rgb_grad) require_shape(*diffuse_rgb_grad, {in.count, 3}, "diffuse_rgb_grad");
  require_shape(diffuse_grad, {in.count, 3}, "diffuse_grad");
  require(specular_grad.has_value() == specular.has_value(), "specular_grad is for specular");
  require(exposure_grad.has_value() == exposure.has_value(), "exposure_grad is for exposure");
  if (specular_grad) require_shape(*specular_grad, {in.count, 3}, "specular_grad");
  if (exposure_grad) {
    require_shape(*exposure_grad, {static_cast<int64_t>(exposure->shape(0)), 6}, "exposure_grad");
    std::fill_n(exposure_grad->data(), exposure_grad->size(), 0.0f);
  }
  const auto run = active().colours_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(in, rgb_grad ? rgb_grad->data() : nullptr, diffuse_rgb_grad ? diffuse_rgb_grad->data() : nullptr,
      {diffuse_grad.data(), specular_grad ? specular_grad->data() : nullptr, exposure_grad ? exposure_grad->data() : nullptr},
      threads);
}

int32_t checked_side(int64_t cells, int64_t side) {
  require(side >= 1 && side <= 1024, "a density grid has 1 to 1024 cells a side, not " + std::to_string(side));
  require(cells == side * side * side, "a density grid of " + std::to_string(side) + " cells a side does not hold " + std::to_string(cells));
  return static_cast<int32_t>(side);
}

void grid_histogram(const CellsTuple& given, const RaysTuple& along, float floor, Out<nb::ndim<2>> out, int threads) {
  const auto& [density, side, bound] = given;
  const auto& [origins, directions, tdist] = along;
  const Cells cells{density.data(), checked_side(static_cast<int64_t>(density.shape(0)), side), !bound.has_value(), bound.value_or(1.0f)};
  const auto rays = static_cast<int64_t>(origins.shape(0)), bins = static_cast<int64_t>(tdist.shape(0)) - 1;
  require(bins >= 1, "a histogram needs at least one interval");
  require_shape(directions, {rays, 3}, "directions");
  require_shape(out, {rays, bins}, "out");
  const auto run = active().grid_histogram;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(cells, origins.data(), directions.data(), rays, tdist.data(), bins, floor, out.data(), threads);
}

void grid_learn(Out<nb::ndim<1>> density, int64_t side, In<nb::shape<-1, 3>> cube, In<nb::ndim<1>> seen, float memory) {
  const int32_t checked = checked_side(static_cast<int64_t>(density.shape(0)), side);
  const auto count = static_cast<int64_t>(cube.shape(0));
  require_shape(seen, {count}, "seen");
  const auto run = active().grid_learn;
  nb::gil_scoped_release release;
  run(density.data(), checked, cube.data(), seen.data(), count, memory);
}

void resample(In<nb::ndim<2>> sdist, In<nb::ndim<2>> weights, std::optional<In<nb::ndim<2>>> jitter,
              Out<nb::ndim<2>> out, int threads) {
  const auto rays = static_cast<int64_t>(weights.shape(0)), n = static_cast<int64_t>(weights.shape(1));
  const int64_t count = static_cast<int64_t>(out.shape(1)) - 1;
  require(count >= 2, "resample draws at least 2 intervals, not " + std::to_string(count));
  require(n >= 1, "resample needs at least one interval to draw from");
  require_shape(sdist, {rays, n + 1}, "sdist");
  require_shape(out, {rays, count + 1}, "out");
  if (jitter) require_shape(*jitter, {rays, count}, "jitter");
  const auto run = active().resample;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(sdist.data(), weights.data(), rays, n, count, jitter ? jitter->data() : nullptr, out.data(), threads);
}

void unit_cube(In<nb::shape<-1, 3>> points, Out<nb::shape<-1, 3>> out, int threads) {
  require_shape(out, {static_cast<int64_t>(points.shape(0)), 3}, "out");
  const auto run = active().unit_cube;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(points.data(), static_cast<int64_t>(points.shape(0)), out.data(), threads);
}

Histograms checked_histograms(const HistogramTuple& histogram, const HistogramTuple& other) {
  const auto& [ends, weights] = histogram;
  const auto& [other_ends, other_weights] = other;
  const auto rays = static_cast<int64_t>(weights.shape(0)), n = static_cast<int64_t>(weights.shape(1));
  const auto m = static_cast<int64_t>(other_weights.shape(1));
  require_shape(ends, {rays, n + 1}, "ends");
  require_shape(other_weights, {rays, m}, "other_weights");
  require_shape(other_ends, {rays, m + 1}, "other_ends");
  return {ends.data(), weights.data(), other_ends.data(), other_weights.data(), rays, n, m};
}

void interlevel_forward(const HistogramTuple& histogram, const HistogramTuple& other, Out<nb::ndim<1>> out, int threads) {
  const Histograms histograms = checked_histograms(histogram, other);
  require_shape(out, {histograms.rays}, "out");
  const auto run = active().interlevel_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(histograms, out.data(), threads);
}

void interlevel_backward(const HistogramTuple& histogram, const HistogramTuple& other, In<nb::ndim<1>> out_grad,
                         Out<nb::ndim<2>> grad, int threads) {
  const Histograms histograms = checked_histograms(histogram, other);
  require_shape(out_grad, {histograms.rays}, "out_grad");
  require_shape(grad, {histograms.rays, histograms.m}, "grad");
  const auto run = active().interlevel_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(histograms, out_grad.data(), grad.data(), threads);
}

int64_t adam(Out<nb::ndim<1>> param, In<nb::ndim<1>> grad, Out<nb::ndim<1>> m, Out<nb::ndim<1>> v, const AdamTuple& how,
             int threads) {
  const auto [step, lr, beta1, beta2, eps, decay, sparse] = how;
  const size_t count = param.shape(0);
  require(grad.shape(0) == count && m.shape(0) == count && v.shape(0) == count, "param, grad, m and v must have the same size");
  require(step >= 1, "steps count from 1, not " + std::to_string(step));
  const auto exponent = static_cast<double>(step);
  const Adam settings{static_cast<float>(lr / (1.0 - std::pow(beta1, exponent))),
                      static_cast<float>(1.0 / std::sqrt(1.0 - std::pow(beta2, exponent))),
                      static_cast<float>(beta1), static_cast<float>(beta2), static_cast<float>(eps),
                      static_cast<float>(decay), sparse};
  const auto run = active().adam;
  check_threads(threads);
  nb::gil_scoped_release release;
  return run(param.data(), grad.data(), m.data(), v.data(), static_cast<int64_t>(count), settings, threads);
}

template <class Tuple>
void check_splats(const Tuple& splats, int64_t count) {
  const auto& [mean, log_scale, rotation, opacity, rgb] = splats;
  require_shape(mean, {count, 3}, "mean");
  require_shape(log_scale, {count, 3}, "log_scale");
  require_shape(rotation, {count, 4}, "rotation");
  require_shape(opacity, {count}, "opacity");
  require_shape(rgb, {count, 3}, "rgb");
}

Splats checked_splats(const SplatsTuple& splats) {
  const auto& [mean, log_scale, rotation, opacity, rgb] = splats;
  const auto count = static_cast<int64_t>(mean.shape(0));
  require(count <= INT32_MAX, "there may be 2^31 - 1 splats, not " + std::to_string(count));
  check_splats(splats, count);
  return {mean.data(), log_scale.data(), rotation.data(), opacity.data(), rgb.data(), count};
}

Pinhole checked_pinhole(const PinholeTuple& camera, size_t height, size_t width) {
  const auto& [intrinsics, cam_from_world, near] = camera;
  const auto [fx, fy, cx, cy] = intrinsics;
  require(near > 0, "near must be positive, not " + std::to_string(near));
  require(fx > 0 && fy > 0, "focal lengths must be positive, not " + std::to_string(fx) + " and " + std::to_string(fy));
  require(height < (1 << 20) && width < (1 << 20), "a picture has less than 2^20 pixels a side");
  Pinhole pinhole{fx, fy, cx, cy, static_cast<int64_t>(width), static_cast<int64_t>(height), near, {}};
  std::copy_n(cam_from_world.data(), 12, pinhole.cam_from_world);
  return pinhole;
}

void splats_forward(const SplatsTuple& splats, const PinholeTuple& camera, Out<nb::shape<-1, -1, 3>> rgb, int threads) {
  const Splats given = checked_splats(splats);
  const Pinhole pinhole = checked_pinhole(camera, rgb.shape(0), rgb.shape(1));
  const auto run = active().splats_forward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(given, pinhole, rgb.data(), threads);
}

void splats_backward(const SplatsTuple& splats, const PinholeTuple& camera, In<nb::shape<-1, -1, 3>> rgb,
                     In<nb::shape<-1, -1, 3>> rgb_grad, const SplatsGradTuple& grads, int threads) {
  const Splats given = checked_splats(splats);
  const Pinhole pinhole = checked_pinhole(camera, rgb.shape(0), rgb.shape(1));
  require_shape(rgb_grad, {pinhole.height, pinhole.width, 3}, "rgb_grad");
  check_splats(grads, given.count);
  std::apply([](const auto&... each) { (std::fill_n(each.data(), each.size(), 0.0f), ...); }, grads);
  const auto& [mean, log_scale, rotation, opacity, colour] = grads;
  const auto run = active().splats_backward;
  check_threads(threads);
  nb::gil_scoped_release release;
  run(given, pinhole, rgb.data(), rgb_grad.data(), {mean.data(), log_scale.data(), rotation.data(), opacity.data(), colour.data()},
      threads);
}

}  // namespace
}  // namespace inpaint3d

NB_MODULE(_native, module) {
  using namespace inpaint3d;
  module.attr("MOST_RUN") = kMostRun;
  module.def("isas", &available, "Paths that this processor runs, best first: of avx512, avx2, portable.");
  module.def("isa", [] { return std::string(active().name); }, "The path in use; the best one at first.");
  module.def(
      "set_isa",
      [](const std::string& name) { require(use(name), "this build or processor has no path '" + name + "'"); },
      "name"_a, "Force a path. ValueError where this processor or build has none of that name.");
  module.def("hash_forward", &hash_forward, "points"_a.noconvert(), "table"_a.noconvert(), "levels"_a,
             "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("hash_backward", &hash_backward, "points"_a.noconvert(), "out_grad"_a.noconvert(), "levels"_a,
             "table_grad"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("mlp_forward", &mlp_forward, "network"_a.noconvert(), "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("mlp_backward", &mlp_backward, "network"_a.noconvert(), "out_grad"_a.noconvert(), "grads"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("composite_forward", &composite_forward, "samples"_a.noconvert(), "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("composite_backward", &composite_backward, "samples"_a.noconvert(), "weights"_a.noconvert(),
             "out_grads"_a.noconvert(), "grads"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("colours_forward", &colours_forward, "logits"_a.noconvert(), "colour_map"_a, "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("colours_backward", &colours_backward, "logits"_a.noconvert(), "colour_map"_a, "out_grads"_a.noconvert(),
             "grads"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("grid_histogram", &grid_histogram, "cells"_a.noconvert(), "rays"_a.noconvert(), "floor"_a, "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("grid_learn", &grid_learn, "density"_a.noconvert(), "side"_a, "cube"_a.noconvert(), "seen"_a.noconvert(),
             "memory"_a);
  module.def("resample", &resample, "sdist"_a.noconvert(), "weights"_a.noconvert(), "jitter"_a.noconvert().none(),
             "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("unit_cube", &unit_cube, "points"_a.noconvert(), "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("interlevel_forward", &interlevel_forward, "histogram"_a.noconvert(), "other"_a.noconvert(), "out"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("interlevel_backward", &interlevel_backward, "histogram"_a.noconvert(), "other"_a.noconvert(),
             "out_grad"_a.noconvert(), "grad"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("adam", &adam, "param"_a.noconvert(), "grad"_a.noconvert(), "m"_a.noconvert(), "v"_a.noconvert(), "how"_a, nb::kw_only(), "threads"_a = 1);
  module.def("splats_forward", &splats_forward, "splats"_a.noconvert(), "camera"_a, "rgb"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
  module.def("splats_backward", &splats_backward, "splats"_a.noconvert(), "camera"_a, "rgb"_a.noconvert(), "rgb_grad"_a.noconvert(), "grads"_a.noconvert(), nb::kw_only(), "threads"_a = 1);
}
