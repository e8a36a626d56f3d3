#include <fmt/format.h>

#include <string>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/instruction_set.hpp>

namespace wiggers {

std::string_view to_string(InstructionSet set) {
  switch (set) {
    case InstructionSet::avx2:
      return "avx2";
    case InstructionSet::avx512:
      return "avx512";
    case InstructionSet::baseline:
      break;
  }
  return "baseline";
}

InstructionSet best_instruction_set() {
#if defined(WIGGERS_X86_KERNELS)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw"))
    return InstructionSet::avx512;
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return InstructionSet::avx2;
#endif
  return InstructionSet::baseline;
}

std::vector<InstructionSet> usable_instruction_sets() {
  std::vector<InstructionSet> sets = {InstructionSet::baseline};
  for (InstructionSet set : {InstructionSet::avx2, InstructionSet::avx512})
    if (set <= best_instruction_set()) sets.push_back(set);
  return sets;
}

InstructionSet instruction_set_by_name(std::string_view name) {
  if (name == "best") return best_instruction_set();
  for (InstructionSet set : {InstructionSet::baseline, InstructionSet::avx2, InstructionSet::avx512}) {
    if (name != to_string(set)) continue;
    if (set > best_instruction_set())
      throw InputError(fmt::format("instruction set {} is not offered by this processor; the best is {}",
                                   name, to_string(best_instruction_set())));
    return set;
  }
  const std::vector<std::string> known = {"best", "baseline", "avx2", "avx512"};
  refuse_unknown("instruction set", name, known);
}

}  // namespace wiggers
