// exp and expm1 of vectors, to about one unit in the last place.
#pragma once

#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {

struct Exponential {
  Floats exp;    // e^x
  Floats expm1;  // e^x - 1, accurate near 0
};

// For x <= 0, as light is absorbed. Below -87 e^x is 0 (the least normal number is e^-87.3); NaN stays NaN.
inline Exponential exponential(Floats x) {
  const Floats clamped = x < -87.0f ? splat(-87.0f) : x;
  // x = n log 2 + r with |r| <= log(2) / 2; truncation rounds to nearest since x <= 0.
  const Ints n = __builtin_convertvector(clamped * 1.44269504f - 0.5f, Ints);
  const Floats whole = __builtin_convertvector(n, Floats);
  const Floats r = (clamped - whole * 0.693359375f) + whole * 2.12194440e-4f;  // log 2 in two parts (Cephes)
  Floats series = splat(1.0f / 5040);
  series = series * r + 1.0f / 720;
  series = series * r + 1.0f / 120;
  series = series * r + 1.0f / 24;
  series = series * r + 1.0f / 6;
  series = series * r + 0.5f;
  const Floats residual = series * (r * r) + r;  // e^r - 1
  const Floats power = (Floats)((n + 127) << 23);
  const Floats exp = power * residual + power;
  const Floats expm1 = power * residual + (power - 1.0f);
  return {x < -87.0f ? splat(0.0f) : exp, x < -87.0f ? splat(-1.0f) : expm1};
}

}  // namespace inpaint3d::INPAINT3D_ISA
