// The summary of a beat as JSON (the last line of `--json`), as entries of a result file and as a table to
// read.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <wiggers/circulation/circulation.hpp>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/heart/indexes/indexes.hpp>

namespace wiggers {

class HeartRun;

std::string version_text();

// Keys: title, indexes, limit_cycle, audits, flips, cost, warnings. What a scene does not have is absent.
nlohmann::ordered_json summarise(const HeartRun& run);

// The same keys for a 0D loop's beat.
struct LoopSummary {
  std::string title;
  Table trace;
  BeatIndexes indexes;
  LimitCycleCertificate certificate;
  std::optional<double> integrator_shift;  // of the cycle, scaled
  bool limit_cycle_wanted = false;
  double wanted_distance = 0;
  double blood_volume_drift_mL = 0;
  double wall_s = 0;
  int beats = 0;
  CirculationParameters circulation;
};
nlohmann::ordered_json summarise(const LoopSummary& loop);

void write_indexes(ResultWriter& file, const BeatIndexes& beat, double body_surface_area_m2);

// The index table for people, with reference ranges and flags.
std::string index_table(const BeatIndexes& beat, double body_surface_area_m2);
// What a beat's shunts carried, a line each.
std::string shunt_lines(const Table& trace);

}  // namespace wiggers
