// Files that are either whole or not there.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

namespace wiggers {

// Writes the bytes to a neighbour of `path`, flushes them to the disk and renames it into place: after a kill
// at any moment, or on a full disk, `path` holds either its previous content or the new one, whole.
// Throws ResourceError (and removes the neighbour) if anything fails.
void write_file_atomically(const std::filesystem::path& path, std::string_view bytes);

// Devices and pipes (/dev/stdout) cannot be renamed into place: they are written through, and nothing is put
// beside them.
bool is_special(const std::filesystem::path& path);

// Refuses, before any work, a path that could not be written later (missing folder, no permission, a folder).
void require_writable(const std::filesystem::path& path, std::string_view option);

// Refuses an output that is one of the inputs.
void refuse_overwriting(const std::filesystem::path& output, std::string_view option,
                        const std::filesystem::path& input);

std::string read_file(const std::filesystem::path& path);

}  // namespace wiggers
