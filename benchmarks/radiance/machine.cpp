// What one core can do at best: `machine fma` prints GFLOP/s, `machine gather BYTES...` ns of a random cache-line read.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <sys/mman.h>

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#else
constexpr int kLanes = 8;
#endif
typedef float Floats __attribute__((vector_size(kLanes * 4)));

// CPU seconds, as the kernels are timed: what others do on the machine is not counted.
static double now() {
  timespec time;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return time.tv_sec + 1e-9 * time.tv_nsec;
}

// Independent chains, enough to hide the latency of an FMA on two ports.
static double fma_gflops() {
  constexpr int kChains = 12;
  constexpr int64_t kTurns = 20'000'000;
  double best = 0;
  for (int round = 0; round < 5; ++round) {
    Floats sum[kChains], a, b;
    for (int l = 0; l < kLanes; ++l) a[l] = 0.999999f, b[l] = 1e-6f;
    for (int c = 0; c < kChains; ++c) sum[c] = b * static_cast<float>(c);
    const double start = now();
    for (int64_t i = 0; i < kTurns; ++i) {
#pragma GCC unroll 12
      for (int c = 0; c < kChains; ++c) sum[c] = sum[c] * a + b;
      // Or the compiler would see through the chains.
      asm volatile("" : "+v"(sum[0]), "+v"(sum[1]), "+v"(sum[2]), "+v"(sum[3]), "+v"(sum[4]), "+v"(sum[5]));
      asm volatile("" : "+v"(sum[6]), "+v"(sum[7]), "+v"(sum[8]), "+v"(sum[9]), "+v"(sum[10]), "+v"(sum[11]));
    }
    const double rate = 2.0 * kTurns * kChains * kLanes / (now() - start) * 1e-9;
    Floats all = sum[0];
    for (int c = 1; c < kChains; ++c) all += sum[c];
    volatile float keep = all[0];
    (void)keep;
    if (rate > best) best = rate;
  }
  return best;
}

// Reads whose addresses do not depend on what was read: as many in flight as the core can hold.
static double gather_ns(int64_t bytes) {
  const int64_t lines = bytes / 64 < 1 ? 1 : bytes / 64;
  const int64_t huge = 2 << 20;
  const int64_t size = (lines * 64 + huge - 1) / huge * huge;
  auto* data = static_cast<float*>(std::aligned_alloc(huge, size));
  madvise(data, size, MADV_HUGEPAGE);
  std::memset(data, 1, size);
  constexpr int64_t kReads = 20'000'000;
  double best = 1e9;
  for (int round = 0; round < 4; ++round) {
    typedef float Row __attribute__((vector_size(16)));
    Row sum{};
    const double start = now();
    for (int64_t i = 0; i < kReads; ++i) {
      uint64_t mixed = static_cast<uint64_t>(i) * 0x9e3779b97f4a7c15ull;
      mixed = (mixed ^ (mixed >> 32)) * 0xd6e8feb86659fd93ull;
      const uint64_t line = ((mixed >> 32) * static_cast<uint64_t>(lines)) >> 32;
      sum += *reinterpret_cast<const Row*>(data + line * 16);
    }
    const double ns = (now() - start) / kReads * 1e9;
    volatile float keep = sum[0];
    (void)keep;
    if (ns < best) best = ns;
  }
  std::free(data);
  return best;
}

int main(int count, char** words) {
  if (count >= 2 && !std::strcmp(words[1], "fma")) {
    std::printf("%.3f\n", fma_gflops());
  } else if (count >= 3 && !std::strcmp(words[1], "gather")) {
    for (int i = 2; i < count; ++i) std::printf("%.4f\n", gather_ns(std::atoll(words[i])));
  } else {
    return 2;
  }
}
