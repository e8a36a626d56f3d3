// Kernels of the instruction set baseline; CMake sets this file's compiler flags.
#include <wiggers/cellmodels/population/kernels.inc.hpp>

namespace wiggers::kernels {
template <>
Kernel<double> find<isa::Baseline, double>(const KernelKey& key) {
  return find_for<Vec<double, 2, isa::Baseline>>(key);
}
template <>
Kernel<float> find<isa::Baseline, float>(const KernelKey& key) {
  return find_for<Vec<float, 4, isa::Baseline>>(key);
}
}  // namespace wiggers::kernels
