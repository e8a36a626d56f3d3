// Kernels of the instruction set avx512; CMake sets this file's compiler flags.
#include <wiggers/cellmodels/population/kernels.inc.hpp>

namespace wiggers::kernels {
template <>
Kernel<double> find<isa::Avx512, double>(const KernelKey& key) {
  return find_for<Vec<double, 8, isa::Avx512>>(key);
}
template <>
Kernel<float> find<isa::Avx512, float>(const KernelKey& key) {
  return find_for<Vec<float, 16, isa::Avx512>>(key);
}
}  // namespace wiggers::kernels
