// Vectors of float and integer lanes, as wide as the instruction set of the translation unit.
//
// Every kernel is compiled once per instruction set into a namespace of its own. Kernel sources use nothing of the
// standard library that the linker could merge between them: an inline function compiled for AVX-512 must never
// serve the portable path.
#pragma once

#include <cstdint>
#include <cstring>

#ifndef INPAINT3D_ISA
#define INPAINT3D_ISA portable
#endif

#if defined(__x86_64__) || defined(__i386__)
#include <xmmintrin.h>
#endif

namespace inpaint3d::INPAINT3D_ISA {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

typedef float Floats __attribute__((vector_size(4 * kLanes)));
typedef int32_t Ints __attribute__((vector_size(4 * kLanes)));
typedef uint32_t Words __attribute__((vector_size(4 * kLanes)));

// Vectors of a fixed size: the channels of one table entry.
typedef float Floats2 __attribute__((vector_size(8)));
typedef float Floats4 __attribute__((vector_size(16)));
typedef float Floats8 __attribute__((vector_size(32)));

template <class Vector, class Scalar>
inline Vector load(const Scalar* from) {
  Vector value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

template <class Vector, class Scalar>
inline void store(Scalar* to, Vector value) {
  std::memcpy(to, &value, sizeof value);
}

// Subtracting zero changes no number, not even -0, and so compiles to a plain broadcast.
inline Floats splat(float value) { return value - Floats{}; }

// A NaN in `a` gives `b`.
inline Floats lower(Floats a, Floats b) { return a < b ? a : b; }
inline Floats upper(Floats a, Floats b) { return a > b ? a : b; }

// Sums of neighbours: the first half of the result comes from a, the second from b.
inline Floats pair_sums(Floats a, Floats b) {
#if defined(__clang__)
  Floats sums;
  for (int i = 0; i < kLanes / 2; ++i) {
    sums[i] = a[2 * i] + a[2 * i + 1];
    sums[i + kLanes / 2] = b[2 * i] + b[2 * i + 1];
  }
  return sums;
#else
  Ints even;
  for (int i = 0; i < kLanes; ++i) even[i] = 2 * i;
  return __builtin_shuffle(a, b, even) + __builtin_shuffle(a, b, even + 1);
#endif
}

// Treats denormal numbers as zero for its lifetime: Adam's moments decay into them, and each costs 100 cycles.
class FlushDenormals {
 public:
#if defined(__x86_64__) || defined(__i386__)
  FlushDenormals() : before_(_mm_getcsr()) { _mm_setcsr(before_ | 0x8040u); }
  ~FlushDenormals() { _mm_setcsr(before_); }

 private:
  unsigned before_;
#else
  FlushDenormals() {}
  ~FlushDenormals() {}
#endif
};

}  // namespace inpaint3d::INPAINT3D_ISA
