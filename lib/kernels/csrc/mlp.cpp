// Small fully connected networks (ReLU between layers, the last one linear), a block of rows at a time: a block's
// activations stay in the cache from the first layer to the last, and the backward pass computes them again.
#include "gemm.hpp"
#include "operations.hpp"
#include "parallel.hpp"

namespace inpaint3d::INPAINT3D_ISA {
namespace {

constexpr int64_t kRows = kMostRun;  // rows of a block, at most: a multiple of the tile's
constexpr int64_t kLeastChunk = 16;  // blocks whose weight gradients are summed together, at least
constexpr int64_t kMostChunks = 64;

// An aligned array that frees itself; zeroed.
class Buffer {
 public:
  explicit Buffer(int64_t count) : base_(new float[count + 16]()) {}
  ~Buffer() { delete[] base_; }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  float* data() const {
    const uintptr_t address = reinterpret_cast<uintptr_t>(base_);
    return base_ + ((64 - address % 64) % 64) / sizeof(float);
  }

 private:
  float* base_;
};

// Where each layer's padded numbers lie in one buffer.
struct Layout {
  int layers;
  const int64_t* width;  // [layers + 1]
  int64_t rows_at(int layer) const {  // activations before `layer`, in a block
    int64_t at = 0;
    for (int i = 0; i < layer; ++i) at += kRows * padded(width[i]);
    return at;
  }
  int64_t across_at(int layer) const {  // weights transposed, [in, padded out]
    int64_t at = 0;
    for (int i = 0; i < layer; ++i) at += width[i] * padded(width[i + 1]);
    return at;
  }
  int64_t along_at(int layer) const {  // weights, [out, padded in]
    int64_t at = 0;
    for (int i = 0; i < layer; ++i) at += width[i + 1] * padded(width[i]);
    return at;
  }
  // A layer's weight gradients are summed as [out, padded in], or as [in, padded out] where that is smaller.
  bool across(int layer) const { return width[layer] * padded(width[layer + 1]) < width[layer + 1] * padded(width[layer]); }
  int64_t sums_at(int layer) const {
    int64_t at = 0;
    for (int i = 0; i < layer; ++i)
      at += across(i) ? width[i] * padded(width[i + 1]) : width[i + 1] * padded(width[i]);
    return at;
  }
  int64_t widest() const {
    int64_t most = 0;
    for (int i = 0; i <= layers; ++i) most = padded(width[i]) > most ? padded(width[i]) : most;
    return most;
  }
};

// Whole runs of rows, as many as fit a block.
inline int64_t block_rows(const Network& net) { return net.starts ? kRows / net.run * net.run : kRows; }

// Weights with rows padded to whole vectors.
struct Packed {
  Buffer across, along;  // [in, padded out]; [out, padded in]
  Packed(const Network& net, const Layout& at) : across(at.across_at(net.layers)), along(at.along_at(net.layers)) {
    for (int layer = 0; layer < net.layers; ++layer) {
      const int64_t in = net.width[layer], out = net.width[layer + 1];
      float* t = across.data() + at.across_at(layer);
      float* w = along.data() + at.along_at(layer);
      for (int64_t o = 0; o < out; ++o) {
        for (int64_t i = 0; i < in; ++i) {
          const float value = net.weights[layer][o * in + i];
          t[i * padded(out) + o] = w[o * padded(in) + i] = value;
        }
      }
    }
  }
};

// Copies [rows, width] between arrays of different row lengths, in whole vectors where both arrays go on that far: what
// these write past a row is padding, or is overwritten by the next row.
inline void copy_rows(const float* from, int64_t from_row, float* to, int64_t to_row, int64_t rows, int64_t width) {
  for (int64_t r = 0; r < rows; ++r) {
    const int64_t left = (rows - r) * (from_row < to_row ? from_row : to_row);
    const float* source = from + r * from_row;
    float* target = to + r * to_row;
    int64_t i = 0;
    for (; i < width && i + kLanes <= left; i += kLanes) store(target + i, load<Floats>(source + i));
    for (; i < width; ++i) target[i] = source[i];
  }
}

// The sum of each vector, in order.
template <int count>
inline Floats reduce(const Floats* rows) {
  if constexpr (count == 2)
    return pair_sums(rows[0], rows[1]);
  else
    return pair_sums(reduce<count / 2>(rows), reduce<count / 2>(rows + count / 2));
}

// A layer with one output, which a product would compute kLanes of: dot products. acts [rows, padded in]; writes
// column 0 of [rows, kLanes].
inline void run_single_output(const float* acts, const float* weights, int64_t rows, int64_t in, float* out) {
  for (int64_t row = 0; row < rows; row += kLanes) {
    Floats partial[kLanes];
    for (int r = 0; r < kLanes; ++r) {
      const float* at = acts + (row + r < rows ? row + r : rows - 1) * in;
      partial[r] = load<Floats>(at) * load<Floats>(weights);
      for (int64_t i = kLanes; i < in; i += kLanes) partial[r] += load<Floats>(at + i) * load<Floats>(weights + i);
    }
    const Floats sums = reduce<kLanes>(partial);
    for (int r = 0; r < kLanes && row + r < rows; ++r) out[(row + r) * kLanes] = sums[r];
  }
}

// Writes each run's start to its rows, [rows, padded width].
inline void begin_sums(const Network& net, int64_t first, int64_t rows, float* sums) {
  const int64_t width = net.width[1], row_length = padded(width);
  for (int64_t r = 0; r < rows; ++r, sums += row_length) {
    const float* start = net.starts + (first + r) / net.run * width;
    for (int64_t o = 0; o < width; ++o) sums[o] = start[o];
    for (int64_t o = width; o < row_length; ++o) sums[o] = 0.0f;
  }
}

// Fills the activations behind the first `layers` layers, of rows from `first` on; x is the first of them.
void run_layers(const Network& net, const Layout& at, const Packed& packed, int layers, const float* x, int64_t first,
                int64_t rows, float* acts) {
  for (int layer = 0; layer < layers; ++layer) {
    if (layer > 0 && layer + 1 == net.layers && net.width[layer + 1] == 1) {
      run_single_output(acts + at.rows_at(layer), packed.along.data() + at.along_at(layer),
                        rows, padded(net.width[layer]), acts + at.rows_at(layer + 1));
      continue;
    }
    Product p{};
    p.a = layer > 0 ? acts + at.rows_at(layer) : x;
    p.a_row = layer > 0 ? padded(net.width[layer]) : net.width[0];
    p.a_step = 1;
    p.b = packed.across.data() + at.across_at(layer);
    p.b_row = p.c_row = padded(net.width[layer + 1]);
    p.depth = net.width[layer];
    p.c = acts + at.rows_at(layer + 1);
    p.add = layer == 0 && net.starts;
    if (p.add) begin_sums(net, first, rows, p.c);
    p.relu = layer + 1 < net.layers;
    multiply(p, rows, p.c_row);
  }
}

// Adds one layer's gradients to `sums`, those of a chunk of rows; the gradient of its output is `grad`, that of its input
// goes to `in_grad` if given.
void layer_adjoint(const Network& net, const Layout& at, const Packed& packed, int layer, int64_t rows,
                   const float* acts, const float* grad, float* in_grad, float* sums) {
  const int64_t in = padded(net.width[layer]), out = padded(net.width[layer + 1]);
  const bool across = at.across(layer);
  Product w{};
  w.a = across ? acts + at.rows_at(layer) : grad;
  w.b = across ? grad : acts + at.rows_at(layer);
  w.a_row = 1;
  w.a_step = across ? in : out;
  w.b_row = w.c_row = across ? out : in;
  w.depth = rows;
  w.c = sums + at.sums_at(layer);
  w.add = true;
  multiply(w, net.width[across ? layer : layer + 1], w.c_row);
  if (!in_grad) return;
  Product x{};
  x.a = grad;
  x.a_row = out;
  x.a_step = 1;
  x.b = packed.along.data() + at.along_at(layer);
  x.b_row = x.c_row = in;
  x.depth = net.width[layer + 1];
  x.c = in_grad;
  x.gate = layer > 0 ? acts + at.rows_at(layer) : nullptr;
  multiply(x, rows, in);
}

struct Scratch {
  Buffer acts, even, odd;
  explicit Scratch(const Layout& at)
      : acts(at.rows_at(at.layers + 1)), even(kRows * at.widest()), odd(kRows * at.widest()) {}
};

// Sums the first layer's gradients [rows, padded width] over each run.
inline void runs_adjoint(const Network& net, const float* grad, int64_t first, int64_t rows, float* starts_grad) {
  const int64_t width = net.width[1], row_length = padded(width);
  for (int64_t r = 0; r < rows; ++r, grad += row_length) {
    float* sum = starts_grad + (first + r) / net.run * width;
    if ((first + r) % net.run == 0)
      for (int64_t o = 0; o < width; ++o) sum[o] = grad[o];
    else
      for (int64_t o = 0; o < width; ++o) sum[o] += grad[o];
  }
}

void block_adjoint(const Network& net, const Layout& at, const Packed& packed, const float* x, const float* out_grad,
                   int64_t first, int64_t rows, float* x_grad, float* starts_grad, float* sums, Scratch& scratch) {
  float* acts = scratch.acts.data();
  copy_rows(x, net.width[0], acts, padded(net.width[0]), rows, net.width[0]);
  run_layers(net, at, packed, net.layers - 1, x, first, rows, acts);
  float* grad = scratch.even.data();
  float* in_grad = scratch.odd.data();
  const int64_t out = net.width[net.layers];
  copy_rows(out_grad, out, grad, padded(out), rows, out);
  for (int layer = net.layers - 1; layer >= 0; --layer) {
    if (layer == 0 && net.starts) runs_adjoint(net, grad, first, rows, starts_grad);
    layer_adjoint(net, at, packed, layer, rows, acts, grad, layer > 0 || x_grad ? in_grad : nullptr, sums);
    float* swapped = grad;
    grad = in_grad;
    in_grad = swapped;
  }
  if (x_grad) copy_rows(grad, padded(net.width[0]), x_grad, net.width[0], rows, net.width[0]);
}

void add_up(const Network& net, const Layout& at, const float* sums, int64_t chunks, NetworkGrad grad) {
  const int64_t all = at.sums_at(net.layers);
  for (int layer = 0; layer < net.layers; ++layer) {
    const int64_t in = net.width[layer], out = net.width[layer + 1];
    for (int64_t o = 0; o < out; ++o) {
      for (int64_t i = 0; i < in; ++i) {
        float sum = 0.0f;
        const int64_t place = at.sums_at(layer) + (at.across(layer) ? i * padded(out) + o : o * padded(in) + i);
        for (int64_t c = 0; c < chunks; ++c) sum += sums[c * all + place];
        grad.weights[layer][o * in + i] = sum;
      }
    }
  }
}

}  // namespace

void mlp_forward(const float* x, int64_t count, Network net, float* out, int threads) {
  const Layout at{net.layers, net.width};
  const Packed packed(net, at);
  const int64_t block = block_rows(net), chunk = block * kLeastChunk, in = net.width[0], last = net.width[net.layers];
  parallel_for((count + chunk - 1) / chunk, threads, [&](int64_t task) {
    const Buffer acts(at.rows_at(net.layers + 1));
    const int64_t end = count < (task + 1) * chunk ? count : (task + 1) * chunk;
    for (int64_t row = task * chunk; row < end; row += block) {
      const int64_t rows = end - row < block ? end - row : block;
      run_layers(net, at, packed, net.layers, x + row * in, row, rows, acts.data());
      copy_rows(acts.data() + at.rows_at(net.layers), padded(last), out + row * last, last, rows, last);
    }
  });
}

// Chunks depend on the number of rows alone, and their sums are added in order: the same bits for any threads.
void mlp_backward(const float* x, int64_t count, Network net, const float* out_grad, float* x_grad, NetworkGrad grad,
                  int threads) {
  const Layout at{net.layers, net.width};
  const Packed packed(net, at);
  const int64_t block = block_rows(net), blocks = (count + block - 1) / block;
  const int64_t even_share = (blocks + kMostChunks - 1) / kMostChunks;
  const int64_t share = even_share > kLeastChunk ? even_share : kLeastChunk;
  const int64_t chunks = (blocks + share - 1) / share, in = net.width[0], last = net.width[net.layers];
  const Buffer sums(chunks * at.sums_at(net.layers));
  parallel_for(chunks, threads, [&](int64_t task) {
    const FlushDenormals flush;
    Scratch scratch(at);
    const int64_t end = count < (task + 1) * share * block ? count : (task + 1) * share * block;
    for (int64_t row = task * share * block; row < end; row += block) {
      const int64_t rows = end - row < block ? end - row : block;
      block_adjoint(net, at, packed, x + row * in, out_grad + row * last, row, rows,
                    x_grad ? x_grad + row * in : nullptr, grad.starts, sums.data() + task * at.sums_at(net.layers),
                    scratch);
    }
  });
  add_up(net, at, sums.data(), chunks, grad);
}

}  // namespace inpaint3d::INPAINT3D_ISA
