// From logits to colours: diffuse and view-dependent, exposed as each run's view was, bounded; with the adjoint.
#include "exponential.hpp"
#include "operations.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int kPoints = 16;           // points handled together: whole vectors of their three channels
constexpr int kNumbers = 3 * kPoints;
constexpr int64_t kShare = 8192;      // points of one task, about

struct Piece {
  alignas(64) float diffuse[kNumbers], specular[kNumbers], gain[kNumbers], offset[kNumbers];
};

// What a run's points share, repeated for each point.
inline void expose(const Logits& in, int64_t row, Piece& piece) {
  float gain[3] = {1.0f, 1.0f, 1.0f}, offset[3] = {};
  for (int c = 0; in.exposure && c < 3; ++c) {
    gain[c] = __builtin_expf(in.exposure[6 * row + c]);
    offset[c] = in.exposure[6 * row + 3 + c];
  }
  for (int i = 0; i < kNumbers; ++i) {
    piece.gain[i] = gain[i % 3];
    piece.offset[i] = offset[i % 3];
  }
}

// [3 count] numbers of the arrays from point `first` on; what lies beyond them is zero.
inline void read(const float* from, int64_t first, int count, float* to) {
  if (!from || count < kPoints) std::memset(to, 0, sizeof(float) * kNumbers);
  if (from) std::memcpy(to, from + 3 * first, sizeof(float) * 3 * static_cast<size_t>(count));
}
inline void write(const float* from, int64_t first, int count, float* to) {
  std::memcpy(to + 3 * first, from, sizeof(float) * 3 * static_cast<size_t>(count));
}

inline Floats sigmoid(Floats x) {
  const Floats e = exponential(x < 0.0f ? x : -x).exp;  // NaN stays NaN
  return (x < 0.0f ? e : splat(1.0f)) / (1.0f + e);
}

// The derivative of what `bounded` gives, times `grad`; at least kLeastSlope, so that black and white can be left again.
constexpr float kLeastSlope = 1e-4f;
inline Floats bounded_adjoint(Floats x, Floats grad, float padding) {
  const Floats s = sigmoid(x), scaled = grad * (1.0f + 2.0f * padding);
  return s * (1.0f - s) < kLeastSlope ? scaled * kLeastSlope : scaled * s * (1.0f - s);
}

// Calls visit(row, first point, count) for pieces of runs, whole runs to a task. The last run may be shorter.
template <class Visit>
inline void for_each_piece(const Logits& in, int threads, const Visit& visit) {
  const int64_t run = in.run > 0 ? in.run : 1, rows = (in.count + run - 1) / run;
  const int64_t share = run < kShare ? kShare / run : 1;
  parallel_for((rows + share - 1) / share, threads, [&](int64_t task) {
    const int64_t end = rows < (task + 1) * share ? rows : (task + 1) * share;
    Piece piece;
    for (int64_t row = task * share; row < end; ++row) {
      if (!in.shared || row == task * share) expose(in, in.shared ? 0 : row, piece);
      const int64_t last = in.count < (row + 1) * run ? in.count : (row + 1) * run;
      for (int64_t first = row * run; first < last; first += kPoints) {
        const int count = static_cast<int>(last - first < kPoints ? last - first : kPoints);
        read(in.diffuse, first, count, piece.diffuse);
        read(in.specular, first, count, piece.specular);
        visit(row, first, count, piece);
      }
    }
  });
}

}  // namespace

void colours_forward(Logits in, float* rgb, float* diffuse_rgb, int threads) {
  for_each_piece(in, threads, [&](int64_t, int64_t first, int count, const Piece& piece) {
    alignas(64) float total[kNumbers], shown[kNumbers];
    for (int i = 0; i < kNumbers; i += kLanes) {
      const Floats diffuse = load<Floats>(piece.diffuse + i), gain = load<Floats>(piece.gain + i);
      const Floats offset = load<Floats>(piece.offset + i);
      const Floats both = diffuse + in.scale * load<Floats>(piece.specular + i);
      store(total + i, sigmoid(both * gain + offset) * (1.0f + 2.0f * in.padding) - in.padding);
      store(shown + i, sigmoid(diffuse * gain + offset) * (1.0f + 2.0f * in.padding) - in.padding);
    }
    write(total, first, count, rgb);
    write(shown, first, count, diffuse_rgb);
  });
}

void colours_backward(Logits in, const float* rgb_grad, const float* diffuse_rgb_grad, LogitsGrad grad, int threads) {
  for_each_piece(in, threads, [&](int64_t row, int64_t first, int count, const Piece& piece) {
    alignas(64) float of_total[kNumbers], of_shown[kNumbers], of_diffuse[kNumbers], of_specular[kNumbers];
    alignas(64) float of_gain[kNumbers], of_offset[kNumbers];
    read(rgb_grad, first, count, of_total);
    read(diffuse_rgb_grad, first, count, of_shown);
    for (int i = 0; i < kNumbers; i += kLanes) {
      const Floats diffuse = load<Floats>(piece.diffuse + i), gain = load<Floats>(piece.gain + i);
      const Floats offset = load<Floats>(piece.offset + i);
      const Floats both = diffuse + in.scale * load<Floats>(piece.specular + i);
      const Floats total = bounded_adjoint(both * gain + offset, load<Floats>(of_total + i), in.padding);
      Floats shown = splat(0.0f);
      if (diffuse_rgb_grad) shown = bounded_adjoint(diffuse * gain + offset, load<Floats>(of_shown + i), in.padding);
      store(of_diffuse + i, (total + shown) * gain);
      store(of_specular + i, in.scale * total * gain);
      store(of_gain + i, (total * both + shown * diffuse) * gain);
      store(of_offset + i, total + shown);
    }
    write(of_diffuse, first, count, grad.diffuse);
    if (grad.specular) write(of_specular, first, count, grad.specular);
    if (!grad.exposure) return;
    float* sums = grad.exposure + 6 * row;
    for (int i = 0; i < 3 * count; ++i) {
      sums[i % 3] += of_gain[i];
      sums[3 + i % 3] += of_offset[i];
    }
  });
}

}  // namespace inpaint3d::INPAINT3D_ISA
