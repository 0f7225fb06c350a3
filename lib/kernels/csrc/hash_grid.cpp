// Multiresolution hash grid (Instant-NGP, arXiv:2201.05989): trilinear reads of a table, and their adjoint.
#include "operations.hpp"
#include "parallel.hpp"
#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int kBatch = 64;           // points whose corners are found together; a multiple of every kLanes
constexpr int64_t kBlock = 2048;     // points of one task of the forward pass: its output stays in L2

struct Corners {
  alignas(64) uint32_t index[8][kBatch];
  alignas(64) float weight[8][kBatch];
};

// The channels of an entry as one vector, for the counts that have one.
template <int channels>
struct EntryOf {
  static constexpr bool kVector = false;
};
template <>
struct EntryOf<2> {
  static constexpr bool kVector = true;
  using Type = Floats2;
};
template <>
struct EntryOf<4> {
  static constexpr bool kVector = true;
  using Type = Floats4;
};
template <>
struct EntryOf<8> {
  static constexpr bool kVector = true;
  using Type = Floats8;
};

struct Batch {
  alignas(64) float x[3][kBatch];
  int count;
};

// Splits [count, 3] points into one row for each axis; rows are padded with the origin.
inline void read_points(const float* points, int count, Batch& batch) {
  batch.count = count;
  for (int p = 0; p < count; ++p)
    for (int axis = 0; axis < 3; ++axis) batch.x[axis][p] = points[3 * p + axis];
  for (int p = count; p < kBatch; ++p)
    for (int axis = 0; axis < 3; ++axis) batch.x[axis][p] = 0.0f;
}

// The eight corners of each point's cell: bits 0, 1, 2 of the corner are x, y, z.
inline void find_corners(const Batch& batch, const Level& level, Corners& corners) {
  const Floats last = splat(static_cast<float>(level.resolution - 1));
  const uint32_t side = static_cast<uint32_t>(level.resolution) + 1u;
  const uint32_t stride[3] = {1u, level.dense ? side : 2654435761u, level.dense ? side * side : 805459861u};
  for (int p = 0; p < batch.count; p += kLanes) {
    Words key[3][2];
    Floats weight[3][2];
    for (int axis = 0; axis < 3; ++axis) {
      const Floats scaled = load<Floats>(batch.x[axis] + p) * static_cast<float>(level.resolution);
      // Keeps any point, NaN too, inside the table; its weights still tell what it was.
      const Ints cell = __builtin_convertvector(lower(upper(scaled, splat(0.0f)), last), Ints);
      const Floats inside = scaled - __builtin_convertvector(cell, Floats);
      key[axis][0] = (Words)cell * stride[axis];
      key[axis][1] = key[axis][0] + stride[axis];
      weight[axis][0] = 1.0f - inside;
      weight[axis][1] = inside;
    }
    for (int corner = 0; corner < 8; ++corner) {
      const int i = corner & 1, j = (corner >> 1) & 1, k = corner >> 2;
      const Words index = level.dense ? key[0][i] + key[1][j] + key[2][k]
                                      : (key[0][i] ^ key[1][j] ^ key[2][k]) & (level.size - 1u);
      store(corners.index[corner] + p, index);
      store(corners.weight[corner] + p, weight[1][j] * weight[2][k] * weight[0][i]);
    }
  }
}

template <int channels>
inline void gather(const Corners& corners, int count, const float* table, float* out, int64_t out_stride) {
  if constexpr (EntryOf<channels>::kVector) {
    using Entry = typename EntryOf<channels>::Type;
    for (int p = 0; p < count; ++p) {
      Entry even{}, odd{};
      for (int corner = 0; corner < 8; corner += 2) {
        even += corners.weight[corner][p] * load<Entry>(table + channels * int64_t{corners.index[corner][p]});
        odd += corners.weight[corner + 1][p] * load<Entry>(table + channels * int64_t{corners.index[corner + 1][p]});
      }
      store(out + p * out_stride, even + odd);
    }
  } else {
    for (int channel = 0; channel < channels; ++channel) {
      alignas(64) float sum[kBatch] = {};
      for (int corner = 0; corner < 8; ++corner)
        for (int p = 0; p < count; ++p)
          sum[p] += corners.weight[corner][p] * table[channels * int64_t{corners.index[corner][p]} + channel];
      for (int p = 0; p < count; ++p) out[p * out_stride + channel] = sum[p];
    }
  }
}

// Adds to the entries with first <= index < first + size.
template <int channels, bool whole>
inline void scatter(const Corners& corners, int count, const float* grad, int64_t grad_stride, uint32_t first,
                    uint32_t size, float* table) {
  for (int p = 0; p < count; ++p) {
    const float* row = grad + p * grad_stride;
    for (int corner = 0; corner < 8; ++corner) {
      const uint32_t index = corners.index[corner][p];
      if (!whole && index - first >= size) continue;
      float* entry = table + channels * int64_t{index};
      const float weight = corners.weight[corner][p];
      if constexpr (EntryOf<channels>::kVector) {
        using Entry = typename EntryOf<channels>::Type;
        store(entry, load<Entry>(entry) + weight * load<Entry>(row));
      } else {
        for (int channel = 0; channel < channels; ++channel) entry[channel] += weight * row[channel];
      }
    }
  }
}

template <int channels>
void forward(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads) {
  const int64_t width = int64_t{grid.level_count} * channels;
  parallel_for((count + kBlock - 1) / kBlock, threads, [&](int64_t block) {
    const int64_t end = count < (block + 1) * kBlock ? count : (block + 1) * kBlock;
    Batch batch;
    Corners corners;
    for (int level = 0; level < grid.level_count; ++level) {
      const float* entries = table + channels * grid.levels[level].offset;
      for (int64_t p = block * kBlock; p < end; p += kBatch) {
        read_points(points + 3 * p, static_cast<int>(end - p < kBatch ? end - p : kBatch), batch);
        find_corners(batch, grid.levels[level], corners);
        gather<channels>(corners, batch.count, entries, out + p * width + level * channels, width);
      }
    }
  });
}

// One task owns a range of one level's entries and visits all points in order: no two tasks touch the same entry, and
// an entry's sum has the same order for any number of ranges.
template <int channels>
void backward(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad, int threads) {
  const int64_t width = int64_t{grid.level_count} * channels;
  const int parts = grid.level_count > 0 ? (threads + grid.level_count - 1) / grid.level_count : 1;
  parallel_for(int64_t{parts} * grid.level_count, threads, [&](int64_t task) {
    // The finest levels cost the most: they go first.
    const int index = grid.level_count - 1 - static_cast<int>(task / parts);
    const Level level = grid.levels[index];
    const uint32_t share = (level.size + parts - 1) / parts;
    const uint32_t first = share * static_cast<uint32_t>(task % parts);
    if (first >= level.size) return;
    const uint32_t size = level.size - first < share ? level.size - first : share;
    float* entries = table_grad + channels * level.offset;
    // Here, not before: the range is then in the cache for what follows.
    std::memset(entries + channels * int64_t{first}, 0, sizeof(float) * channels * int64_t{size});
    Batch batch;
    Corners corners;
    for (int64_t p = 0; p < count; p += kBatch) {
      read_points(points + 3 * p, static_cast<int>(count - p < kBatch ? count - p : kBatch), batch);
      find_corners(batch, level, corners);
      const float* grad = out_grad + p * width + index * channels;
      if (parts == 1)
        scatter<channels, true>(corners, batch.count, grad, width, 0, level.size, entries);
      else
        scatter<channels, false>(corners, batch.count, grad, width, first, size, entries);
    }
  });
}

using Forward = void (*)(const float*, int64_t, const float*, Grid, float*, int);
constexpr Forward kForward[8] = {forward<1>, forward<2>, forward<3>, forward<4>,
                                 forward<5>, forward<6>, forward<7>, forward<8>};
constexpr Forward kBackward[8] = {backward<1>, backward<2>, backward<3>, backward<4>,
                                  backward<5>, backward<6>, backward<7>, backward<8>};

// The squares of numbers: in lanes of float over a run that is short enough for them, then in double.
inline double sum_of_squares(const float* values, int64_t count) {
  constexpr int64_t kRun = 4096;
  double total = 0.0;
  for (int64_t start = 0; start < count; start += kRun) {
    const int64_t end = start + kRun < count ? start + kRun : count;
    Floats sums{};
    int64_t i = start;
    for (; i + kLanes <= end; i += kLanes) {
      const Floats value = load<Floats>(values + i);
      sums += value * value;
    }
    for (int lane = 0; lane < kLanes; ++lane) total += sums[lane];
    for (; i < end; ++i) total += values[i] * values[i];
  }
  return total;
}

constexpr int64_t kSquares = 1 << 16;  // numbers of a task

}  // namespace

void mean_squares(const float* table, Grid grid, double* level_means, int threads) {
  for (int index = 0; index < grid.level_count; ++index) {
    const Level& level = grid.levels[index];
    const float* values = table + level.offset * grid.channels;
    const int64_t count = int64_t{level.size} * grid.channels, tasks = (count + kSquares - 1) / kSquares;
    double* sums = new double[tasks];
    parallel_for(tasks, threads, [&](int64_t task) {
      const int64_t start = task * kSquares;
      sums[task] = sum_of_squares(values + start, count - start < kSquares ? count - start : kSquares);
    });
    double total = 0.0;
    for (int64_t task = 0; task < tasks; ++task) total += sums[task];
    delete[] sums;
    level_means[index] = total / static_cast<double>(count);
  }
}

void mean_squares_backward(const float* table, Grid grid, double out_grad, float* table_grad, int threads) {
  for (int index = 0; index < grid.level_count; ++index) {
    const Level& level = grid.levels[index];
    const int64_t start = level.offset * grid.channels, count = int64_t{level.size} * grid.channels;
    const float scale = static_cast<float>(2.0 * out_grad / static_cast<double>(count));
    parallel_for((count + kSquares - 1) / kSquares, threads, [&](int64_t task) {
      const int64_t end = count < (task + 1) * kSquares ? count : (task + 1) * kSquares;
      for (int64_t i = start + task * kSquares; i < start + end; ++i) table_grad[i] = scale * table[i];
    });
  }
}

void hash_forward(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads) {
  kForward[grid.channels - 1](points, count, table, grid, out, threads);
}

void hash_backward(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad,
                   int threads) {
  kBackward[grid.channels - 1](points, count, out_grad, grid, table_grad, threads);
}

}  // namespace inpaint3d::INPAINT3D_ISA
