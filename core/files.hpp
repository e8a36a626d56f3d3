// Files: one safe writer, one reader, and a memory of which files are inputs and which are outputs.
//
// A file is either whole or as it was. What a process reads as an input is never written by it: the readers
// record what they open and require_writable() what will be written, so that no verb can forget one.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <wiggers/core/file_kind.hpp>

namespace wiggers {

// Writes the bytes to a neighbour of `path`, flushes them to the disk and renames it into place: after a kill
// at any moment, or on a full disk, `path` holds either its previous content or the new one, whole. The
// neighbour has an unpredictable name and is opened exclusively; an earlier file's mode is kept; neighbours
// that killed runs left are removed. A link is followed to the file that it names. Devices, pipes and open
// files (/dev/stdout, /dev/fd/3) are written through.
// Throws ResourceError (and removes the neighbour) if anything fails.
void write_file_atomically(const std::filesystem::path& path, std::string_view bytes);

// Devices, pipes and what a process has open (/dev/stdout, /proc/self/fd/1), also behind links: they cannot
// be renamed into place, and nothing is put beside them.
bool is_special(const std::filesystem::path& path);

// Refuses, before any work, a path that could not be written later (missing folder, no permission, a folder),
// that holds a file of another kind than what is to be written, or that is an input or another output of this
// process, through links as well; from now on it is an output.
void require_writable(const std::filesystem::path& path, std::string_view option, FileKind kind);
// The same for the folder of a field series, in which files come and go: no input may be in it, it must not
// be a link, and frames in it must be those of a series. It need not exist.
void require_writable_folder(const std::filesystem::path& folder, std::string_view option);
// Says that the file at an output's place is of another kind.
[[noreturn]] void refuse_other_kind(const std::filesystem::path& path, std::string_view option,
                                    FileKind kind);

// Records an input; refuses one that is an output of this process. The readers call it; so does who learns of
// an input long before it is read.
void note_input(const std::filesystem::path& path);
// From now on the result is input and output of this process: a run goes on in it.
void allow_going_on_in(const std::filesystem::path& result);

// The content of an input. A pipe or device is read once, later calls get the same text; one without end, or
// without a writer, is refused. A missing file is refused with the nearest name in its folder.
std::string read_file(const std::filesystem::path& path);
// The content of a file that this process goes on writing: no input.
std::string read_own_file(const std::filesystem::path& path);
// Whether a pipe or device was read: another program could not read it again.
bool special_file_was_read();

}  // namespace wiggers
