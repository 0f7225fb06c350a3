// Pictures of Gaussians: tiles of the picture, each with the splats that touch it, the nearest first (3D Gaussian
// Splatting, arXiv:2308.04079, section 6). Seen from a black room.
#include "exponential.hpp"
#include "operations.hpp"
#include "splat_projection.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int kTile = 16;           // pixels along a tile's side
constexpr int kVectors = kTile / kLanes;
constexpr int kPixels = kTile * kTile;
constexpr float kDarkest = 1e-4f;   // light that is left, below which a pixel takes no more splats
constexpr int64_t kSplats = 2048;   // splats of one task
constexpr int kUntilLook = 32;      // splats between two looks whether a tile is done

// Of one picture: all footprints, and for each tile the entries that touch it. Entries are numbered splat by splat.
struct Scene {
  int64_t count, columns, tiles, entries;
  Footprint* footprint;   // [count]
  int64_t* first_entry;   // [count + 1]
  int64_t* tile_start;    // [tiles + 1]; has had a place more, to be filled by
  int64_t* tile_entry;    // [entries], by tile, the nearest splat first
  int32_t* tile_splat;    // [entries], whose entry it is
};

struct TileRange {
  int32_t x0, x1, y0, y1;
  int64_t count() const { return int64_t{x1 - x0} * (y1 - y0); }
};

inline TileRange touch(const Footprint& f) {
  if (f.x0 >= f.x1) return {0, 0, 0, 0};
  return {f.x0 / kTile, (f.x1 + kTile - 1) / kTile, f.y0 / kTile, (f.y1 + kTile - 1) / kTile};
}

// The splats in the order of their depth, equal ones in their own (radix sort; positive floats sort as integers).
void sort_by_depth(const Footprint* footprint, int64_t count, int32_t* order, int32_t* other) {
  constexpr int kBits = 11, kRound = 1 << kBits;
  for (int64_t i = 0; i < count; ++i) order[i] = static_cast<int32_t>(i);
  for (int shift = 0; shift < 33; shift += kBits) {
    int64_t start[kRound + 1] = {};
    const auto digit = [&](int32_t i) {
      uint32_t bits;
      std::memcpy(&bits, &footprint[i].z, sizeof bits);
      return (bits >> shift) & (kRound - 1);
    };
    for (int64_t i = 0; i < count; ++i) ++start[digit(order[i]) + 1];
    for (int d = 0; d < kRound; ++d) start[d + 1] += start[d];
    for (int64_t i = 0; i < count; ++i) other[start[digit(order[i])]++] = order[i];
    int32_t* const swap = order;
    order = other;
    other = swap;
  }
}

Scene arrange(const Splats& splats, const Pinhole& camera, int threads) {
  Scene s{};
  s.count = splats.count;
  s.columns = (camera.width + kTile - 1) / kTile;
  s.tiles = s.columns * ((camera.height + kTile - 1) / kTile);
  s.footprint = new Footprint[s.count];
  s.first_entry = new int64_t[s.count + 1];
  s.tile_start = new int64_t[s.tiles + 2]();
  parallel_for((s.count + kSplats - 1) / kSplats, threads, [&](int64_t task) {
    const int64_t end = s.count < (task + 1) * kSplats ? s.count : (task + 1) * kSplats;
    for (int64_t i = task * kSplats; i < end; ++i) s.footprint[i] = look(splats, camera, i);
  });
  s.first_entry[0] = 0;
  for (int64_t i = 0; i < s.count; ++i) {
    const TileRange range = touch(s.footprint[i]);
    s.first_entry[i + 1] = s.first_entry[i] + range.count();
    for (int32_t y = range.y0; y < range.y1; ++y)
      for (int32_t x = range.x0; x < range.x1; ++x) ++s.tile_start[y * s.columns + x + 2];
  }
  s.entries = s.first_entry[s.count];
  for (int64_t t = 0; t < s.tiles; ++t) s.tile_start[t + 2] += s.tile_start[t + 1];
  s.tile_entry = new int64_t[s.entries];
  s.tile_splat = new int32_t[s.entries];
  int32_t* order = new int32_t[2 * s.count];
  sort_by_depth(s.footprint, s.count, order, order + s.count);
  const int32_t* sorted = order + s.count;  // three rounds end in the other half
  for (int64_t k = 0; k < s.count; ++k) {
    const TileRange range = touch(s.footprint[sorted[k]]);
    int64_t entry = s.first_entry[sorted[k]];
    for (int32_t y = range.y0; y < range.y1; ++y)
      for (int32_t x = range.x0; x < range.x1; ++x) {
        const int64_t at = s.tile_start[y * s.columns + x + 1]++;
        s.tile_entry[at] = entry++;
        s.tile_splat[at] = sorted[k];
      }
  }
  delete[] order;
  return s;
}

void drop(const Scene& s) {
  delete[] s.footprint;
  delete[] s.first_entry;
  delete[] s.tile_start;
  delete[] s.tile_entry;
  delete[] s.tile_splat;
}

// The part of a footprint that lies in a tile: rows, and vectors of a row.
struct Part {
  int row0, row1, vector0, vector1;
};

inline Part clip(const Footprint& f, int64_t left, int64_t top) {
  const int64_t x0 = f.x0 - left, x1 = f.x1 - left, y0 = f.y0 - top, y1 = f.y1 - top;
  return {static_cast<int>(y0 > 0 ? y0 : 0), static_cast<int>(y1 < kTile ? y1 : kTile),
          static_cast<int>(x0 > 0 ? x0 / kLanes : 0),
          static_cast<int>(x1 < kTile ? (x1 + kLanes - 1) / kLanes : kVectors)};
}

struct Shade {
  Floats dx, gauss, alpha;
  Ints free;  // alpha moves with the Gaussian: neither cut off nor held
};

inline Shade shade(const Footprint& f, Floats dx, float dy, Floats light) {
  const Floats half = -0.5f * (dx * (f.a * dx + 2.0f * f.b * dy) + f.c * dy * dy);
  const Floats gauss = exponential(lower(half, Floats{})).exp, alpha = f.opacity * gauss;
  const Ints seen = (alpha >= kFaintest) & (light > kDarkest), held = alpha > kMostOpaque;
  return {dx, gauss, seen ? (held ? splat(kMostOpaque) : alpha) : Floats{}, seen & ~held};
}

inline Floats lane_numbers() {
  Floats lanes;
  for (int i = 0; i < kLanes; ++i) lanes[i] = static_cast<float>(i);
  return lanes;
}

inline float sum(Floats values) {
  float total = 0;
  for (int i = 0; i < kLanes; ++i) total += values[i];
  return total;
}

inline bool is_done(const float* light) {
  Ints any{};
  for (int i = 0; i < kPixels; i += kLanes) any |= load<Floats>(light + i) > kDarkest;
  for (int i = 0; i < kLanes; ++i)
    if (any[i]) return false;
  return true;
}

// Calls visit(footprint, entry, pixel, dx, dy) for what of each splat lies in a tile, a vector of pixels at a time.
template <class Begin, class Visit, class End>
inline void walk(const Scene& s, int64_t tile, const float* light, const Begin& begin, const Visit& visit, const End& end) {
  const int64_t left = tile % s.columns * kTile, top = tile / s.columns * kTile;
  const Floats lanes = lane_numbers() + 0.5f;
  for (int64_t k = s.tile_start[tile], done = 1; k < s.tile_start[tile + 1]; ++k, ++done) {
    const Footprint& f = s.footprint[s.tile_splat[k]];
    const Part part = clip(f, left, top);
    begin();
    for (int row = part.row0; row < part.row1; ++row) {
      const float dy = static_cast<float>(top + row) + 0.5f - f.y;
      for (int v = part.vector0; v < part.vector1; ++v)
        visit(f, row * kTile + v * kLanes, lanes + (static_cast<float>(left + v * kLanes) - f.x), dy);
    }
    end(f, s.tile_entry[k]);
    if (done % kUntilLook == 0 && is_done(light)) return;
  }
}

struct TilePicture {
  float light[kPixels], rgb[3][kPixels];
};

// Copies between a tile [3, kPixels] and a picture [height, width, 3]; what lies outside the picture is 0.
template <bool kToTile, class Picture>
inline void copy(const Pinhole& camera, const Scene& s, int64_t tile, float (*inside)[kPixels], Picture* picture) {
  const int64_t left = tile % s.columns * kTile, top = tile / s.columns * kTile;
  for (int64_t y = top; y < top + kTile && y < camera.height; ++y)
    for (int64_t x = left; x < left + kTile && x < camera.width; ++x)
      for (int k = 0; k < 3; ++k) {
        auto& out = picture[(y * camera.width + x) * 3 + k];
        float& in = inside[k][(y - top) * kTile + x - left];
        if constexpr (kToTile) in = out; else out = in;
      }
}

}  // namespace

void splats_forward(Splats splats, Pinhole camera, float* rgb, int threads) {
  const Scene s = arrange(splats, camera, threads);
  parallel_for(s.tiles, threads, [&](int64_t tile) {
    TilePicture p{};
    for (float& light : p.light) light = 1.0f;
    walk(
        s, tile, p.light, [] {},
        [&](const Footprint& f, int at, Floats dx, float dy) {
          const Floats light = load<Floats>(p.light + at);
          const Floats weight = shade(f, dx, dy, light).alpha * light;
          for (int k = 0; k < 3; ++k) store(p.rgb[k] + at, load<Floats>(p.rgb[k] + at) + weight * f.rgb[k]);
          store(p.light + at, light - weight);
        },
        [](const Footprint&, int64_t) {});
    copy<false>(camera, s, tile, p.rgb, rgb);
  });
  drop(s);
}

// Light that passes a splat is shared among those behind it: what they add to a pixel is all of its colour, less what
// has been met so far. So the way back goes front to back, too, and finds the light as the way there did.
void splats_backward(Splats splats, Pinhole camera, const float* rgb, const float* rgb_grad, SplatsGrad grad, int threads) {
  const Scene s = arrange(splats, camera, threads);
  FootprintGrad* entry_grad = new FootprintGrad[s.entries]();
  parallel_for(s.tiles, threads, [&](int64_t tile) {
    TilePicture p{}, g{};
    float (&behind)[kPixels] = g.light;  // gradient of all that is behind, times its colour
    for (float& light : p.light) light = 1.0f;
    copy<true>(camera, s, tile, p.rgb, rgb);
    copy<true>(camera, s, tile, g.rgb, rgb_grad);
    for (int i = 0; i < kPixels; ++i) behind[i] = p.rgb[0][i] * g.rgb[0][i] + p.rgb[1][i] * g.rgb[1][i] + p.rgb[2][i] * g.rgb[2][i];
    Floats total[9];  // by opacity, by the exponent times 1, dx, dy, dx^2, dx dy, dy^2... and by colour
    walk(
        s, tile, p.light,
        [&] {
          for (Floats& part : total) part = Floats{};
        },
        [&](const Footprint& f, int at, Floats dx, float dy) {
          const Floats light = load<Floats>(p.light + at);
          const Shade seen = shade(f, dx, dy, light);
          const Floats weight = seen.alpha * light;
          Floats by_weight{};
          for (int k = 0; k < 3; ++k) {
            const Floats by_rgb = load<Floats>(g.rgb[k] + at);
            by_weight += f.rgb[k] * by_rgb;
            total[6 + k] += weight * by_rgb;
          }
          const Floats rest = load<Floats>(behind + at) - weight * by_weight;
          const Floats by_alpha = seen.free ? light * by_weight - rest / (1.0f - seen.alpha) : Floats{};
          const Floats by_exponent = by_alpha * seen.alpha, by_dx = by_exponent * dx;
          total[0] += by_alpha * seen.gauss;
          total[1] += by_dx;
          total[2] += by_exponent * dy;
          total[3] += by_dx * dx;
          total[4] += by_dx * dy;
          total[5] += by_exponent * (dy * dy);
          store(behind + at, rest);
          store(p.light + at, light - weight);
        },
        [&](const Footprint& f, int64_t entry) {
          const float x = sum(total[1]), y = sum(total[2]);
          entry_grad[entry] = {f.a * x + f.b * y, f.b * x + f.c * y, -0.5f * sum(total[3]), -sum(total[4]),
                               -0.5f * sum(total[5]), sum(total[0]), {sum(total[6]), sum(total[7]), sum(total[8])}};
        });
  });
  parallel_for((s.count + kSplats - 1) / kSplats, threads, [&](int64_t task) {
    const int64_t end = s.count < (task + 1) * kSplats ? s.count : (task + 1) * kSplats;
    for (int64_t i = task * kSplats; i < end; ++i) {
      if (s.first_entry[i] == s.first_entry[i + 1]) continue;
      FootprintGrad all{};
      for (int64_t e = s.first_entry[i]; e < s.first_entry[i + 1]; ++e) add(all, entry_grad[e]);
      look_back(splats, camera, i, s.footprint[i], all, grad);
    }
  });
  delete[] entry_grad;
  drop(s);
}

}  // namespace inpaint3d::INPAINT3D_ISA
