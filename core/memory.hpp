// Memory that a request would need, estimated before the work.
#pragma once

#include <string_view>

namespace wiggers {

// Bytes that could be taken now: of the machine, of this process's control group or within its own limit.
double available_memory();

// Refuses rows of columns of numbers that would fill more than a quarter of the available memory (for their
// growth and for writing them as much again is needed). `asked_by` names the option or key with its value,
// `remedy` what to change.
void require_memory(double rows, double columns, std::string_view asked_by, std::string_view remedy);

}  // namespace wiggers
