// Register-blocked products of small matrices: c = epilogue(start + a b).
#pragma once

#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {

// A tile's sums, one row of b and one number of a fill the registers: 32 of them, or 16.
#if defined(__AVX512F__)
constexpr int kTileSums = 24;
constexpr int kTileVectors = 4;
#else
constexpr int kTileSums = 12;
constexpr int kTileVectors = 2;
#endif
constexpr int tile_rows(int vectors) { return vectors == 1 ? 12 : kTileSums / vectors; }

// Widths are padded to whole vectors; padding may hold anything, and nothing else is computed from it.
inline int64_t padded(int64_t width) { return (width + kLanes - 1) / kLanes * kLanes; }

struct Product {
  const float* a;  // a(r, k) = a[r * a_row + k * a_step]
  int64_t a_row, a_step;
  const float* b;  // [depth, b_row], columns contiguous
  int64_t b_row;
  int64_t depth;
  float* c;  // [rows, c_row]
  int64_t c_row;
  bool add = false;             // sums start from what c holds, not from zero
  bool relu = false;            // then max(c, 0)
  const float* gate = nullptr;  // [rows, c_row]: then zero where the gate is not positive
};

template <int rows, int vectors>
inline void tile(const Product& p, int64_t row, int64_t column) {
  Floats sum[rows][vectors];  // stays in registers since every loop over it is unrolled
#pragma GCC unroll 12
  for (int r = 0; r < rows; ++r) {
#pragma GCC unroll 4
    for (int v = 0; v < vectors; ++v) {
      const int64_t at = column + v * kLanes;
      sum[r][v] = p.add ? load<Floats>(p.c + (row + r) * p.c_row + at) : splat(0.0f);
    }
  }
  const float* a = p.a + row * p.a_row;
  const float* b = p.b + column;
  for (int64_t k = 0; k < p.depth; ++k, a += p.a_step, b += p.b_row) {
    Floats line[vectors];
#pragma GCC unroll 4
    for (int v = 0; v < vectors; ++v) line[v] = load<Floats>(b + v * kLanes);
#pragma GCC unroll 12
    for (int r = 0; r < rows; ++r) {
      const Floats left = splat(a[r * p.a_row]);
#pragma GCC unroll 4
      for (int v = 0; v < vectors; ++v) sum[r][v] += left * line[v];
    }
  }
#pragma GCC unroll 12
  for (int r = 0; r < rows; ++r) {
#pragma GCC unroll 4
    for (int v = 0; v < vectors; ++v) {
      const int64_t at = (row + r) * p.c_row + column + v * kLanes;
      Floats value = sum[r][v];
      if (p.relu) value = value < 0.0f ? splat(0.0f) : value;  // NaN stays NaN
      if (p.gate) value = load<Floats>(p.gate + at) > 0.0f ? value : splat(0.0f);
      store(p.c + at, value);
    }
  }
}

// The last rows, fewer than a tile's.
template <int rows, int vectors>
inline void last_tile(const Product& p, int64_t row, int64_t left, int64_t column) {
  if constexpr (rows > 0) {
    if (left == rows)
      tile<rows, vectors>(p, row, column);
    else
      last_tile<rows - 1, vectors>(p, row, left, column);
  }
}

template <int vectors>
inline void strip(const Product& p, int64_t rows, int64_t column) {
  constexpr int kRows = tile_rows(vectors);
  int64_t row = 0;
  for (; row + kRows <= rows; row += kRows) tile<kRows, vectors>(p, row, column);
  last_tile<kRows - 1, vectors>(p, row, rows - row, column);
}

// `width` counts c's columns, padding included.
inline void multiply(const Product& p, int64_t rows, int64_t width) {
  int64_t column = 0;
  for (; column + kTileVectors * kLanes <= width; column += kTileVectors * kLanes) strip<kTileVectors>(p, rows, column);
  const int64_t rest = (width - column) / kLanes;
  if (rest == 1) strip<1>(p, rows, column);
  if constexpr (kTileVectors == 4) {
    if (rest == 2) strip<2>(p, rows, column);
    if (rest == 3) strip<3>(p, rows, column);
  }
}

}  // namespace inpaint3d::INPAINT3D_ISA
