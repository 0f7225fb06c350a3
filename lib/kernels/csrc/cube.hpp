// Space contracted into the ball of radius 2 (Mip-NeRF 360, arXiv:2111.12077, eq. 10).
#pragma once

#include "simd.hpp"

namespace inpaint3d::INPAINT3D_ISA {

// What a point is multiplied by: 1 in the unit ball, exactly; NaN stays NaN.
inline float contraction_scale(float x, float y, float z) {
  const float ax = __builtin_fabsf(x), ay = __builtin_fabsf(y), az = __builtin_fabsf(z);
  float largest = ax > ay ? ax : ay;
  largest = largest > az ? largest : az;
  largest = largest > 1.0f ? largest : 1.0f;
  // Divided by the largest, since squares overflow at 1e19.
  const float a = x / largest, b = y / largest, c = z / largest;
  const float length = largest * __builtin_sqrtf(a * a + b * b + c * c), outer = 1.0f / length;
  return length <= 1.0f ? 1.0f : (2.0f - outer) * outer;
}

}  // namespace inpaint3d::INPAINT3D_ISA
