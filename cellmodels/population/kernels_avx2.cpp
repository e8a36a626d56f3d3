// Kernels of the instruction set avx2; CMake sets this file's compiler flags.
#include <wiggers/cellmodels/population/kernels.inc.hpp>

namespace wiggers::kernels {
template <>
Kernel<double> find<isa::Avx2, double>(const KernelKey& key) {
  return find_for<Vec<double, 4, isa::Avx2>>(key);
}
template <>
Kernel<float> find<isa::Avx2, float>(const KernelKey& key) {
  return find_for<Vec<float, 8, isa::Avx2>>(key);
}
}  // namespace wiggers::kernels
