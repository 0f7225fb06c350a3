// Densities kept in the cells of a cube: what a ray meets there, and how they are learnt.
#include "cube.hpp"
#include "exponential.hpp"
#include "operations.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int64_t kRays = 128;  // rays of one task

// The cell along an axis; a NaN is in the first.
inline int32_t cell_of(float place, int32_t side) {
  const float scaled = place * static_cast<float>(side);
  const float last = static_cast<float>(side - 1);
  return static_cast<int32_t>(scaled > 0.0f ? (scaled < last ? scaled : last) : 0.0f);
}

// -optical depth of each interval of a ray: density at its middle times its length.
inline void absorb(const Cells& cells, const float* origin, const float* direction, const float* middle,
                   const float* length, int64_t bins, int32_t* index, float* depth) {
  const float inverse = cells.contraction ? 0.0f : 1.0f / cells.bound;
#pragma GCC ivdep
  for (int64_t i = 0; i < bins; ++i) {
    const float x = origin[0] + direction[0] * middle[i], y = origin[1] + direction[1] * middle[i];
    const float z = origin[2] + direction[2] * middle[i];
    const float scale = cells.contraction ? 0.25f * contraction_scale(x, y, z) : 0.5f * inverse;
    const int32_t column = cell_of(x * scale + 0.5f, cells.side), row = cell_of(y * scale + 0.5f, cells.side);
    index[i] = (cell_of(z * scale + 0.5f, cells.side) * cells.side + row) * cells.side + column;
  }
  for (int64_t i = 0; i < bins; ++i) depth[i] = -cells.density[index[i]] * length[i];
}

// Weights of volume rendering, each interval's and its neighbours' larger ones halved and added, and the floor.
inline void spread(const float* depth, int64_t bins, float floor, float* before, float* weight, float* out) {
  float front = 0.0f;
  for (int64_t i = 0; i < bins; ++i) {
    before[i] = front;
    front += depth[i];
  }
  for (int64_t i = 0; i < bins; i += kLanes)
    store(weight + i, -exponential(load<Floats>(depth + i)).expm1 * exponential(load<Floats>(before + i)).exp);
  for (int64_t i = 0; i < bins; ++i) {
    const float here = weight[i], left = i > 0 ? weight[i - 1] : here, right = i + 1 < bins ? weight[i + 1] : here;
    out[i] = ((left > here ? left : here) + (right > here ? right : here)) * 0.5f + floor;
  }
}

}  // namespace

void grid_histogram(Cells cells, const float* origins, const float* directions, int64_t rays, const float* tdist,
                    int64_t bins, float floor, float* out, int threads) {
  const int64_t room = (bins + kLanes - 1) / kLanes * kLanes;
  parallel_for((rays + kRays - 1) / kRays, threads, [&](int64_t task) {
    float* memory = new float[5 * room]();
    int32_t* index = new int32_t[room];
    float *middle = memory, *length = middle + room, *depth = length + room, *before = depth + room, *weight = before + room;
    for (int64_t i = 0; i < bins; ++i) {
      middle[i] = (tdist[i] + tdist[i + 1]) * 0.5f;
      length[i] = tdist[i + 1] - tdist[i];
    }
    const int64_t end = rays < (task + 1) * kRays ? rays : (task + 1) * kRays;
    for (int64_t r = task * kRays; r < end; ++r) {
      absorb(cells, origins + 3 * r, directions + 3 * r, middle, length, bins, index, depth);
      spread(depth, bins, floor, before, weight, out + r * bins);
    }
    delete[] index;
    delete[] memory;
  });
}

// A density that has been lessened carries a minus sign until all are.
void grid_learn(float* density, int32_t side, const float* cube, const float* seen, int64_t count, float memory) {
  int32_t* index = new int32_t[count];
  for (int64_t i = 0; i < count; ++i) {
    const float* at = cube + 3 * i;
    index[i] = (cell_of(at[2], side) * side + cell_of(at[1], side)) * side + cell_of(at[0], side);
  }
  for (int64_t i = 0; i < count; ++i) {
    float& kept = density[index[i]];
    if (!__builtin_signbit(kept)) kept = -(memory * kept);
  }
  for (int64_t i = 0; i < count; ++i) {
    float& kept = density[index[i]];
    kept = __builtin_fabsf(kept);
    if (kept == kept && !(seen[i] <= kept)) kept = seen[i];  // a NaN stays, whatever else is seen
  }
  delete[] index;
}

}  // namespace inpaint3d::INPAINT3D_ISA
