// What a rate does to a heart whose parameters were made for another one, in words: none of it is an error,
// all of it should be known.
#pragma once

#include <string>
#include <vector>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/indexes.hpp>
#include <wiggers/heart/paced_cells.hpp>

namespace wiggers {

std::vector<std::string> rate_warnings(const Table& beat, const BeatIndexes& indexes,
                                       const std::map<std::string, PacedCellType>& cells);

}  // namespace wiggers
