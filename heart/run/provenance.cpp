#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/run/provenance.hpp>
#include <wiggers/heart/run/summary.hpp>

namespace wiggers {

namespace {

// The scene without its [run] table: what a resumed run must share with its checkpoint.
std::string without_run_table(const std::string& text) {
  const std::size_t begin = text.find("\n[run]");
  if (begin == std::string::npos) return text;
  const std::size_t end = text.find("\n[", begin + 1);
  return text.substr(0, begin) + (end == std::string::npos ? "" : text.substr(end));
}

}  // namespace

void write_provenance(ResultWriter& file, const std::string& title, const std::string& scene_text,
                      bool complete, double wall_time_s) {
  file.text("/provenance/status", complete ? "complete" : "incomplete");
  file.text("/provenance/scene", scene_text);
  file.text("/provenance/title", title);
  file.text("/provenance/version", version_text());
  char host[256] = "";
  gethostname(host, sizeof host - 1);
  file.text("/provenance/host", host);
  file.scalar("/provenance/wall_time", wall_time_s, "s", "wall time of cells and heart, or of the body");
}

void require_same_scene(const ResultReader& file, const std::filesystem::path& path,
                        const std::string& scene_text) {
  const std::string saved = without_run_table(file.text("/provenance/scene"));
  file.verify();
  const std::string now = without_run_table(scene_text);
  if (saved != now) {
    const auto difference = std::mismatch(saved.begin(), saved.end(), now.begin(), now.end());
    const auto line_at = [](const std::string& text, std::string::const_iterator at) {
      const auto offset = static_cast<std::size_t>(at - text.begin());
      const std::size_t begin = offset == 0 ? 0 : text.rfind('\n', offset - 1) + 1;
      return text.substr(begin, text.find('\n', offset) - begin);
    };
    throw InputError(fmt::format("--resume {}: it was computed from another scene: there '{}', here '{}'",
                                 path.string(), line_at(saved, difference.first),
                                 line_at(now, difference.second)));
  }
}

}  // namespace wiggers
