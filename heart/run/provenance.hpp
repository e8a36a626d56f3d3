// Where a result comes from: the scene with all its defaults, the version, the machine; and whether a run may
// go on from it.
#pragma once

#include <filesystem>
#include <string>
#include <wiggers/core/result_file.hpp>

namespace wiggers {

void write_provenance(ResultWriter& file, const std::string& title, const std::string& scene_text,
                      bool complete, double wall_time_s);

// Refuses a result that was computed from another scene, or with other contents of the files that it names,
// and one that is damaged; their [run] tables may differ.
void require_same_scene(const ResultReader& file, const std::filesystem::path& path,
                        const std::string& scene_text);

}  // namespace wiggers
