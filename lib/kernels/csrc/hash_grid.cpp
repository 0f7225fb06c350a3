// Multiresolution hash grid (Instant-NGP, arXiv:2201.05989): trilinear reads of a table, and their adjoint.
#include "operations.hpp"
#include "parallel.hpp"
#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

// Points whose corners are found together, a multiple of every kLanes: the lines of one batch on their way and those of
// the batch in work fit a core's first cache.
constexpr int kBatch = 32;
// Points handled level by level, at most: many, since a level's entries are then in L2 for most.
constexpr int64_t kBlock = 1 << 16;
// Numbers of a point beyond which a block keeps its levels in planes of their own.
constexpr int64_t kLongRow = 16;
// Levels of fewer numbers need no prefetch.
constexpr int64_t kInCache = 1 << 17;

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
inline void prefetch(const Corners& corners, int count, const float* table) {
  for (int corner = 0; corner < 8; ++corner)
    for (int p = 0; p < count; ++p) __builtin_prefetch(table + channels * int64_t{corners.index[corner][p]});
}

// Calls visit(first point, count, corners) for each batch of points in order; the entries of the batch that follows are
// on their way to the cache meanwhile.
template <int channels, class Visit>
inline void for_each_batch(const float* points, int64_t start, int64_t end, const Level& level, const float* entries,
                           const Visit& visit) {
  const bool ahead = int64_t{level.size} * channels >= kInCache;
  Batch batch[2];
  Corners corners[2];
  int now = 0;
  for (int64_t p = start; p < end + kBatch; p += kBatch, now = 1 - now) {
    if (p < end) {
      read_points(points + 3 * p, static_cast<int>(end - p < kBatch ? end - p : kBatch), batch[now]);
      find_corners(batch[now], level, corners[now]);
      if (ahead) prefetch<channels>(corners[now], batch[now].count, entries);
    }
    if (p > start) visit(p - kBatch, batch[1 - now].count, corners[1 - now]);
  }
}

// A block's features, a plane [points, channels] for each level: what one level reads or writes lies together, where
// rows of all levels would drive its entries out of the cache. Short rows need none of this, and stay where they are.
template <int channels>
class Planes {
 public:
  Planes(int64_t points, Grid grid)
      : width_(int64_t{grid.level_count} * channels),
        used_(width_ > kLongRow),
        points_(points),
        memory_(new float[used_ ? points * width_ : 0]) {}
  ~Planes() { delete[] memory_; }
  Planes(const Planes&) = delete;
  Planes& operator=(const Planes&) = delete;

  // Where a level's numbers of the block's first point are, given its row; and how far it is to the next point's.
  template <class Number>
  Number* at(Number* rows, int level) const {
    return used_ ? memory_ + level * points_ * channels : rows + level * channels;
  }
  int64_t stride() const { return used_ ? channels : width_; }

  void from_rows(const float* rows, int64_t begin, int64_t end) const {
    if (!used_) return;
    for_each_entry(begin, end, [&](int64_t row, float* plane) { copy(rows + row, plane); });
  }
  void to_rows(float* rows, int64_t begin, int64_t end) const {
    if (!used_) return;
    for_each_entry(begin, end, [&](int64_t row, float* plane) { copy(plane, rows + row); });
  }

 private:
  template <class Visit>
  void for_each_entry(int64_t begin, int64_t end, const Visit& visit) const {
    for (int64_t p = begin; p < end; ++p)
      for (int64_t at = 0; at < width_; at += channels) visit(p * width_ + at, memory_ + at * points_ + p * channels);
  }
  static void copy(const float* from, float* to) {
    for (int c = 0; c < channels; ++c) to[c] = from[c];
  }

  int64_t width_;
  bool used_;
  int64_t points_;
  float* memory_;
};

template <int channels>
void forward(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads) {
  const int64_t width = int64_t{grid.level_count} * channels;
  const int64_t share = ((count + threads - 1) / threads + kBatch - 1) / kBatch * kBatch;
  const int64_t block = share < kBlock ? share : kBlock;
  parallel_for(count == 0 ? 0 : (count + block - 1) / block, threads, [&](int64_t task) {
    const int64_t begin = task * block, n = count - begin < block ? count - begin : block;
    const Planes<channels> planes(n, grid);
    for (int index = 0; index < grid.level_count; ++index) {
      const Level& level = grid.levels[index];
      const float* entries = table + channels * level.offset;
      float* to = planes.at(out + begin * width, index);
      for_each_batch<channels>(points + 3 * begin, 0, n, level, entries,
                               [&](int64_t p, int batch, const Corners& corners) {
                                 gather<channels>(corners, batch, entries, to + p * planes.stride(), planes.stride());
                               });
    }
    planes.to_rows(out + begin * width, 0, n);
  });
}

// One task owns a range of one level's entries and visits a block's points in order: no two tasks touch the same entry,
// and an entry's sum has the same order for any number of ranges.
template <int channels>
void backward(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad, int threads) {
  const int64_t width = int64_t{grid.level_count} * channels;
  const int parts = grid.level_count > 0 ? (threads + grid.level_count - 1) / grid.level_count : 1;
  const Planes<channels> planes(count < kBlock ? count : kBlock, grid);
  for (int64_t begin = 0; begin == 0 || begin < count; begin += kBlock) {
    const int64_t n = count - begin < kBlock ? count - begin : kBlock;
    const float* rows = out_grad + begin * width;
    const int64_t share_of_copy = (n + threads - 1) / threads;
    parallel_for(threads, threads, [&](int64_t task) {
      const int64_t end = n < (task + 1) * share_of_copy ? n : (task + 1) * share_of_copy;
      planes.from_rows(rows, task * share_of_copy, end);
    });
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
      if (begin == 0) std::memset(entries + channels * int64_t{first}, 0, sizeof(float) * channels * int64_t{size});
      const float* from = planes.at(rows, index);
      for_each_batch<channels>(points + 3 * begin, 0, n, level, entries,
                               [&](int64_t p, int batch, const Corners& corners) {
                                 const float* grad = from + p * planes.stride();
                                 if (parts == 1)
                                   scatter<channels, true>(corners, batch, grad, planes.stride(), 0, level.size, entries);
                                 else
                                   scatter<channels, false>(corners, batch, grad, planes.stride(), first, size, entries);
                               });
    });
  }
}

using Forward = void (*)(const float*, int64_t, const float*, Grid, float*, int);
constexpr Forward kForward[8] = {forward<1>, forward<2>, forward<3>, forward<4>,
                                 forward<5>, forward<6>, forward<7>, forward<8>};
constexpr Forward kBackward[8] = {backward<1>, backward<2>, backward<3>, backward<4>,
                                  backward<5>, backward<6>, backward<7>, backward<8>};

}  // namespace

void hash_forward(const float* points, int64_t count, const float* table, Grid grid, float* out, int threads) {
  kForward[grid.channels - 1](points, count, table, grid, out, threads);
}

void hash_backward(const float* points, int64_t count, const float* out_grad, Grid grid, float* table_grad,
                   int threads) {
  kBackward[grid.channels - 1](points, count, out_grad, grid, table_grad, threads);
}

}  // namespace inpaint3d::INPAINT3D_ISA
