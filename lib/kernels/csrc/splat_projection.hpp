// One Gaussian as a camera sees it (EWA splatting, Zwicker et al. 2001; 3D Gaussian Splatting, Kerbl et al. 2023,
// arXiv:2308.04079, eqs. 4 to 6), and the way back for its gradients.
#pragma once

#include "kernels.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {

constexpr float kLowPass = 0.3f;         // added to the variances in the picture, px^2: nothing is thinner than a pixel
constexpr float kFaintest = 1.0f / 255;  // a splat ends where it is fainter
constexpr float kMostOpaque = 0.99f;     // so that light is never divided by 0 on the way back
constexpr float kSideways = 1.3f;        // the local affine camera is taken from no further out than 1.3 half pictures

struct Footprint {
  float x, y, z;              // centre in pixels, depth along the axis
  float a, b, c;              // inverse covariance [a b; b c], px^-2
  float opacity, rgb[3];
  int32_t x0, x1, y0, y1;     // pixels that it may cover, ends excluded; none where x0 = x1
};

// By footprint: of its centre, inverse covariance, opacity and colour.
struct FootprintGrad {
  float x, y, a, b, c, opacity, rgb[3];
};

inline void add(FootprintGrad& total, const FootprintGrad& part) {
  total.x += part.x;
  total.y += part.y;
  total.a += part.a;
  total.b += part.b;
  total.c += part.c;
  total.opacity += part.opacity;
  for (int k = 0; k < 3; ++k) total.rgb[k] += part.rgb[k];
}

// What lies between a Gaussian and its footprint.
struct Projection {
  float t[3];           // centre in the camera
  float u, v;           // t.x / t.z and t.y / t.z, held near the picture
  bool u_free, v_free;  // not held
  float rotation[9], scale[3], inverse_length;
  float m[6];           // Jacobian of the projection x world to camera, [2, 3]
  float mr[6];          // m x rotation
  float xx, xy, yy;     // covariance in the picture
};

inline void rotate(const float* q, float inverse_length, float* out) {
  const float w = q[0] * inverse_length, x = q[1] * inverse_length, y = q[2] * inverse_length, z = q[3] * inverse_length;
  const float rotation[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z),     2 * (x * z + w * y),
                             2 * (x * y + w * z),     1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                             2 * (x * z - w * y),     2 * (y * z + w * x),     1 - 2 * (x * x + y * y)};
  for (int i = 0; i < 9; ++i) out[i] = rotation[i];
}

inline float hold(float value, float low, float high) { return value < low ? low : value > high ? high : value; }

// False where the centre is nearer than `near`, or not finite.
inline bool project(const Splats& splats, const Pinhole& camera, int64_t i, Projection& p) {
  const float* mean = splats.mean + 3 * i;
  const float* w = camera.cam_from_world;
  for (int r = 0; r < 3; ++r) p.t[r] = w[4 * r] * mean[0] + w[4 * r + 1] * mean[1] + w[4 * r + 2] * mean[2] + w[4 * r + 3];
  const float z = p.t[2];
  if (!(z >= camera.near) || !(z < 1e30f)) return false;
  const float width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  const float side_x = kSideways * 0.5f * width / camera.fx, side_y = kSideways * 0.5f * height / camera.fy;
  const float middle_x = (0.5f * width - camera.cx) / camera.fx, middle_y = (0.5f * height - camera.cy) / camera.fy;
  p.u = hold(p.t[0] / z, middle_x - side_x, middle_x + side_x);
  p.v = hold(p.t[1] / z, middle_y - side_y, middle_y + side_y);
  p.u_free = p.u == p.t[0] / z;
  p.v_free = p.v == p.t[1] / z;
  for (int k = 0; k < 3; ++k) {
    p.m[k] = camera.fx / z * (w[k] - p.u * w[8 + k]);
    p.m[3 + k] = camera.fy / z * (w[4 + k] - p.v * w[8 + k]);
    p.scale[k] = __builtin_expf(splats.log_scale[3 * i + k]);
  }
  const float* q = splats.rotation + 4 * i;
  p.inverse_length = 1.0f / __builtin_sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  rotate(q, p.inverse_length, p.rotation);
  p.xx = p.yy = kLowPass;
  p.xy = 0;
  for (int k = 0; k < 3; ++k) {
    for (int r = 0; r < 2; ++r)
      p.mr[3 * r + k] = p.m[3 * r] * p.rotation[k] + p.m[3 * r + 1] * p.rotation[3 + k] + p.m[3 * r + 2] * p.rotation[6 + k];
    const float s = p.scale[k] * p.scale[k];
    p.xx += s * p.mr[k] * p.mr[k];
    p.xy += s * p.mr[k] * p.mr[3 + k];
    p.yy += s * p.mr[3 + k] * p.mr[3 + k];
  }
  return true;
}

// The pixels whose centres lie within `reach` of `middle`, of `count`; false where there are none.
inline bool cover(float middle, float reach, int64_t count, int32_t& first, int32_t& end) {
  const float last = static_cast<float>(count);
  first = static_cast<int32_t>(hold(__builtin_ceilf(middle - reach - 0.5f), 0, last));
  end = static_cast<int32_t>(hold(__builtin_floorf(middle + reach - 0.5f) + 1, 0, last));
  return first < end;
}

// A Gaussian that the picture does not show, or that is not finite, covers no pixel.
inline Footprint look(const Splats& splats, const Pinhole& camera, int64_t i) {
  Footprint f{};
  Projection p;
  if (!project(splats, camera, i, p)) return f;
  f.opacity = 1.0f / (1.0f + __builtin_expf(-splats.opacity[i]));
  const float faintest = f.opacity / kFaintest, determinant = p.xx * p.yy - p.xy * p.xy;
  if (!(faintest > 1.0f) || !(determinant > 0.0f) || !(determinant < 1e30f)) return f;
  f.x = camera.fx * p.t[0] / p.t[2] + camera.cx;
  f.y = camera.fy * p.t[1] / p.t[2] + camera.cy;
  f.z = p.t[2];
  const float reach = 2.0f * __builtin_logf(faintest);  // of the exponent, where the splat ends
  const bool seen = cover(f.x, __builtin_sqrtf(reach * p.xx), camera.width, f.x0, f.x1) &&
                    cover(f.y, __builtin_sqrtf(reach * p.yy), camera.height, f.y0, f.y1);
  if (!seen) f.x0 = f.x1 = 0;
  f.a = p.yy / determinant;
  f.b = -p.xy / determinant;
  f.c = p.xx / determinant;
  for (int k = 0; k < 3; ++k) f.rgb[k] = splats.rgb[3 * i + k];
  return f;
}

// By the inverse covariance -> by the covariance's xx, xy, yy: -K G K.
inline void invert_back(const Footprint& f, const FootprintGrad& g, float* by) {
  const float b = 0.5f * g.b;
  const float l00 = g.a * f.a + b * f.b, l01 = g.a * f.b + b * f.c, l10 = b * f.a + g.c * f.b, l11 = b * f.b + g.c * f.c;
  by[0] = -(f.a * l00 + f.b * l10);
  by[1] = -2.0f * (f.a * l01 + f.b * l11);
  by[2] = -(f.b * l01 + f.c * l11);
}

// By the rotation matrix [3, 3] -> by a quaternion q of any length.
inline void rotate_back(const float* q, float inverse_length, const float* by, float* grad) {
  const float w = q[0] * inverse_length, x = q[1] * inverse_length, y = q[2] * inverse_length, z = q[3] * inverse_length;
  const float unit[4] = {
      2 * (x * (by[7] - by[5]) + y * (by[2] - by[6]) + z * (by[3] - by[1])),
      2 * (y * (by[1] + by[3]) + z * (by[2] + by[6]) + w * (by[7] - by[5])) - 4 * x * (by[4] + by[8]),
      2 * (x * (by[1] + by[3]) + z * (by[5] + by[7]) + w * (by[2] - by[6])) - 4 * y * (by[0] + by[8]),
      2 * (x * (by[2] + by[6]) + y * (by[5] + by[7]) + w * (by[3] - by[1])) - 4 * z * (by[0] + by[4])};
  const float along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
  const float direction[4] = {w, x, y, z};
  for (int k = 0; k < 4; ++k) grad[k] = (unit[k] - along * direction[k]) * inverse_length;
}

// Writes the Gaussian's gradients, given those of its footprint.
inline void look_back(const Splats& splats, const Pinhole& camera, int64_t i, const Footprint& f, const FootprintGrad& g,
                      const SplatsGrad& out) {
  Projection p;
  if (!project(splats, camera, i, p)) return;
  const float* w = camera.cam_from_world;
  const float z = p.t[2];
  float by_cov[3];
  invert_back(f, g, by_cov);
  float by_m[6] = {}, by_rotation[9];
  for (int k = 0; k < 3; ++k) {
    const float s = p.scale[k] * p.scale[k];
    const float by_mr[2] = {s * (2 * by_cov[0] * p.mr[k] + by_cov[1] * p.mr[3 + k]),
                            s * (by_cov[1] * p.mr[k] + 2 * by_cov[2] * p.mr[3 + k])};
    out.log_scale[3 * i + k] = by_mr[0] * p.mr[k] + by_mr[1] * p.mr[3 + k];
    for (int r = 0; r < 3; ++r) {
      by_rotation[3 * r + k] = p.m[r] * by_mr[0] + p.m[3 + r] * by_mr[1];
      by_m[r] += by_mr[0] * p.rotation[3 * r + k];
      by_m[3 + r] += by_mr[1] * p.rotation[3 * r + k];
    }
  }
  rotate_back(splats.rotation + 4 * i, p.inverse_length, by_rotation, out.rotation + 4 * i);
  float by_u = 0, by_v = 0, by_z = 0;
  for (int k = 0; k < 3; ++k) {
    by_u -= camera.fx / z * w[8 + k] * by_m[k];
    by_v -= camera.fy / z * w[8 + k] * by_m[3 + k];
    by_z -= (p.m[k] * by_m[k] + p.m[3 + k] * by_m[3 + k]) / z;
  }
  const float by_x = (camera.fx * g.x + (p.u_free ? by_u : 0)) / z, by_y = (camera.fy * g.y + (p.v_free ? by_v : 0)) / z;
  const float by_t[3] = {by_x, by_y, by_z - (p.t[0] * by_x + p.t[1] * by_y) / z};
  for (int k = 0; k < 3; ++k) {
    out.mean[3 * i + k] = w[k] * by_t[0] + w[4 + k] * by_t[1] + w[8 + k] * by_t[2];
    out.rgb[3 * i + k] = g.rgb[k];
  }
  out.opacity[i] = g.opacity * f.opacity * (1.0f - f.opacity);
}

}  // namespace inpaint3d::INPAINT3D_ISA
