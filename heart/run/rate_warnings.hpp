// What a rate does to a heart whose parameters were made for another one, in words: none of it is an error,
// all of it should be known.
#pragma once

#include <string>
#include <vector>
#include <wiggers/core/table.hpp>
#include <wiggers/heart/indexes/indexes.hpp>
#include <wiggers/heart/run/paced_cells.hpp>

namespace wiggers {

// What stands beside the verdict of a cycle that the equations have and a heart can be in, but that no one
// should take for a good heart: a ventricle that hardly ejects; with rows of the beat, one that does not
// relax.
std::vector<std::string> ejection_warnings(const BeatIndexes& indexes);
std::vector<std::string> verdict_warnings(const Table& beat, const BeatIndexes& indexes);

std::vector<std::string> rate_warnings(const Table& beat, const BeatIndexes& indexes,
                                       const std::map<std::string, PacedCellType>& cells);

}  // namespace wiggers
