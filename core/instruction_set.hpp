// Which SIMD instructions this processor offers; kernels compiled for each are chosen by it at run time.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace wiggers {

enum class InstructionSet { baseline, avx2, avx512 };

std::string_view to_string(InstructionSet set);

// The best set that this processor, its operating system and this build support.
InstructionSet best_instruction_set();

// All usable sets, baseline first.
std::vector<InstructionSet> usable_instruction_sets();

// "best" or a set by name; refuses an unknown name, and a set this processor does not have.
InstructionSet instruction_set_by_name(std::string_view name);

}  // namespace wiggers
