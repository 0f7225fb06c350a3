// Python bindings: every shape and index is checked here, so that the kernels need not.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cmath>
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

int checked_threads(int threads) {
  require(threads >= 1, "threads must be at least 1, not " + std::to_string(threads));
  return threads;
}

void hash_forward(In<nb::shape<-1, 3>> points, In<nb::ndim<2>> table, const std::vector<LevelTuple>& levels,
                  Out<nb::ndim<2>> out, int threads) {
  const auto laid_out = checked_levels(levels, static_cast<int64_t>(table.shape(0)));
  const Grid grid = checked_grid(laid_out, table.shape(1), out.shape(1));
  check_rows(points.shape(0), out.shape(0));
  const auto run = active().hash_forward;
  nb::gil_scoped_release release;
  run(points.data(), static_cast<int64_t>(points.shape(0)), table.data(), grid, out.data(), checked_threads(threads));
}

void hash_backward(In<nb::shape<-1, 3>> points, In<nb::ndim<2>> out_grad, const std::vector<LevelTuple>& levels,
                   Out<nb::ndim<2>> table_grad, int threads) {
  const auto laid_out = checked_levels(levels, static_cast<int64_t>(table_grad.shape(0)));
  const Grid grid = checked_grid(laid_out, table_grad.shape(1), out_grad.shape(1));
  check_rows(points.shape(0), out_grad.shape(0));
  const auto run = active().hash_backward;
  nb::gil_scoped_release release;
  run(points.data(), static_cast<int64_t>(points.shape(0)), out_grad.data(), grid, table_grad.data(),
      checked_threads(threads));
}

void adam(Out<nb::ndim<1>> param, In<nb::ndim<1>> grad, Out<nb::ndim<1>> m, Out<nb::ndim<1>> v, int64_t step,
          double lr, double beta1, double beta2, double eps, int threads) {
  const size_t count = param.shape(0);
  require(grad.shape(0) == count && m.shape(0) == count && v.shape(0) == count, "param, grad, m and v must have the same size");
  require(step >= 1, "steps count from 1, not " + std::to_string(step));
  const auto exponent = static_cast<double>(step);
  const Adam settings{static_cast<float>(lr / (1.0 - std::pow(beta1, exponent))),
                      static_cast<float>(1.0 / std::sqrt(1.0 - std::pow(beta2, exponent))),
                      static_cast<float>(beta1), static_cast<float>(beta2), static_cast<float>(eps)};
  const auto run = active().adam;
  nb::gil_scoped_release release;
  run(param.data(), grad.data(), m.data(), v.data(), static_cast<int64_t>(count), settings, checked_threads(threads));
}

}  // namespace
}  // namespace inpaint3d

NB_MODULE(_native, module) {
  using namespace inpaint3d;
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
  module.def("adam", &adam, "param"_a.noconvert(), "grad"_a.noconvert(), "m"_a.noconvert(), "v"_a.noconvert(),
             nb::kw_only(), "step"_a, "lr"_a, "beta1"_a, "beta2"_a, "eps"_a, "threads"_a = 1);
}
