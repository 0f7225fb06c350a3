#include "dispatch.hpp"

#include <atomic>

namespace inpaint3d {
namespace {

std::vector<const Kernels*> runnable() {
  std::vector<const Kernels*> found;
#if defined(INPAINT3D_HAS_AVX512)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("fma"))
    found.push_back(&avx512::kKernels);
#endif
#if defined(INPAINT3D_HAS_AVX2)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) found.push_back(&avx2::kKernels);
#endif
  found.push_back(&portable::kKernels);
  return found;
}

std::atomic<const Kernels*>& chosen() {
  static std::atomic<const Kernels*> pointer{runnable().front()};
  return pointer;
}

}  // namespace

std::vector<std::string> available() {
  std::vector<std::string> names;
  for (const Kernels* kernels : runnable()) names.emplace_back(kernels->name);
  return names;
}

const Kernels& active() { return *chosen().load(); }

bool use(const std::string& name) {
  for (const Kernels* kernels : runnable()) {
    if (name == kernels->name) {
      chosen().store(kernels);
      return true;
    }
  }
  return false;
}

}  // namespace inpaint3d
