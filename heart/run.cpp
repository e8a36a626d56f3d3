#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <wiggers/cellmodels/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/elastance_wall.hpp>
#include <wiggers/heart/run.hpp>
#include <wiggers/heart/summary.hpp>

namespace wiggers {

namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

PacedCell make_paced_cell(const Scene& scene, const CellType& cell) {
  return PacedCell(*cell.ionic, cell.ionic_parameters, {scene.period_s * units::ms_per_s, cell.stimulus},
                   {scene.electrophysiology_integrator, 1e-8, 1e-10, scene.electrophysiology_substep_ms});
}

// Where a column of the trace stands in the result file.
std::string place_of(const std::string& name) {
  const auto is_one_of = [](const auto& names, std::string_view wanted) {
    return std::find(names.begin(), names.end(), wanted) != names.end();
  };
  if (name == "t_s") return "/time";
  if (const auto dot = name.find('.'); dot != std::string::npos)
    return "/cells/" + name.substr(0, dot) + "/" + name.substr(dot + 1);
  const std::string place = name.substr(2);
  if (is_one_of(valve_names, place)) return "/valves/" + place + "/flow";
  if (is_one_of(chamber_names, place))
    return "/cavities/" + place + (name[0] == 'V' ? "/volume" : "/pressure");
  return "/circulation/" + name;
}

// The scene without its [run] table: what a resumed run must share with its checkpoint.
std::string without_run_table(const std::string& text) {
  const std::size_t begin = text.find("\n[run]");
  if (begin == std::string::npos) return text;
  const std::size_t end = text.find("\n[", begin + 1);
  return text.substr(0, begin) + (end == std::string::npos ? "" : text.substr(end));
}

}  // namespace

HeartRun::HeartRun(Scene scene) : scene_(std::move(scene)) {}

void HeartRun::prepare(Progress::Style style) {
  const auto begin = Clock::now();
  for (const auto& [name, cell] : scene_.cells) {
    PacedCellType paced;
    if (cell.ionic) {
      PacedCell one = make_paced_cell(scene_, cell);
      paced.state_at_onset = cell.ionic->default_state();
      if (cell.from_limit_cycle) {
        Progress progress(fmt::format("cells {} ({})", name, cell.ionic->name), style);
        LimitCycleSettings settings;
        paced.certificate =
            one.to_limit_cycle(paced.state_at_onset, settings, [&](const LimitCycleCertificate& c) {
              progress.update(-1, fmt::format("beat {}, distance {:.1e}", c.beats, c.distance));
            });
        if (paced.certificate.verdict != LimitCycleVerdict::period_1)
          throw NumericalFailure(
              fmt::format("cells {}: {} at {} ms did not reach its limit cycle: {} after {} beats, distance "
                          "{:.2g}. Use start = "
                          "\"published\" or another period.",
                          name, cell.ionic->name, scene_.period_s * 1e3, to_string(paced.certificate.verdict),
                          paced.certificate.beats, paced.certificate.distance));
        progress.finish(fmt::format("on the limit cycle after {} beats, distance {:.1e}",
                                    paced.certificate.beats, paced.certificate.distance));
        paced.charge_drift_mV = one.invariant_drift();
      }
      double low = std::numeric_limits<double>::infinity(), high = 0, peak = -1000;
      std::vector<double> state = paced.state_at_onset;
      one.beat(state, 1.0, [&](double, const double* y, double) {
        const double calcium = y[cell.ionic->cytosolic_calcium] * units::uM_per_mM;
        low = std::min(low, calcium);
        high = std::max(high, calcium);
        peak = std::max(peak, y[cell.ionic->membrane_potential]);
      });
      paced.potential_max_mV = peak;
      CalciumRescaling rescaling = cell.rescaling;
      rescaling.diastolic_uM = low;
      paced.calcium_min_uM = rescaling(low);
      paced.calcium_max_uM = rescaling(high);
    } else {
      paced.calcium_min_uM = cell.transient.rest_uM;
      paced.calcium_max_uM = cell.transient.peak_uM;
    }
    cells_.emplace(name, std::move(paced));
  }
  build();
  driver_->start(scene_.initial);
  cost_.cells_s = seconds_since(begin);
}

ActiveFibre HeartRun::make_fibre(const FibrePlan& plan, const std::string& place) const {
  const CellType& type = scene_.cells.at(plan.cells);
  const PacedCellType& paced = cells_.at(plan.cells);
  const double period_ms = scene_.period_s * units::ms_per_s;
  std::unique_ptr<CellSource> source;
  if (type.ionic) {
    CalciumRescaling rescaling = type.rescaling;
    if (rescaling.reading == CalciumReading::peak) rescaling.diastolic_uM = paced.calcium_min_uM;
    source = std::make_unique<IonicCellSource>(
        *type.ionic, type.ionic_parameters, paced.state_at_onset,
        IonicCellSource::Pacing{period_ms, plan.activation_ms, type.stimulus,
                                scene_.electrophysiology_integrator, scene_.electrophysiology_substep_ms},
        rescaling);
  } else {
    source = std::make_unique<PrescribedCalcium>(type.transient, period_ms, plan.activation_ms);
  }
  return ActiveFibre(plan.settings, plan.force_parameters, paced.calcium_min_uM, std::move(source), place);
}

void HeartRun::build() {
  std::vector<std::unique_ptr<Wall>> walls;
  for (const WallPlan& plan : scene_.walls) {
    if (plan.kind == "elastance") {
      walls.push_back(
          std::make_unique<ElastanceWall>(plan.cavities.front(), plan.elastance, scene_.period_s));
    } else if (plan.kind == "reduced") {
      walls.push_back(std::make_unique<ReducedWall>(plan.cavities.front(), plan.reduced,
                                                    make_fibre(plan.fibres.front(), plan.name)));
    } else {
      std::array<std::unique_ptr<ActiveFibre>, n_segments> segments;
      for (int i = 0; i < n_segments; ++i)
        segments[i] = std::make_unique<ActiveFibre>(
            make_fibre(plan.fibres[i], fmt::format("{}.{}", plan.name, segment_names[i])));
      walls.push_back(std::make_unique<TriSegWall>(plan.triseg, std::move(segments)));
    }
  }
  driver_ =
      std::make_unique<HeartDriver>(DriverSettings{scene_.period_s, scene_.dt_s, scene_.stabilise_volumes,
                                                   scene_.implicit_inductors, scene_.pericardium},
                                    scene_.circulation, std::move(walls));
  LimitCycleSettings settings = scene_.limit_cycle;
  if (!scene_.until_limit_cycle) {
    // A number of beats was asked for: judge, but neither accelerate nor stop.
    settings.method = LimitCycleMethod::pacing;
    settings.distance = -1;
    settings.map_noise = -1;
    settings.max_beats = std::numeric_limits<int>::max();
  } else {
    settings.plain_beats = 3;
  }
  search_ = std::make_unique<LimitCycleSearch>(settings, circulation_scales());
  trace_ = driver_->trace();
  initial_volume_ = total_volume(scene_.circulation, scene_.initial.data());
}

void HeartRun::resume(const std::filesystem::path& path) {
  const ResultReader file(path);
  const std::string saved = without_run_table(file.text("/provenance/scene"));
  const std::string now = without_run_table(scene_.text);
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
  for (const auto& [name, cell] : scene_.cells) {
    const std::string group = "/checkpoint/cells/" + name;
    PacedCellType paced;
    if (cell.ionic) paced.state_at_onset = file.dataset(group + "/state_at_onset");
    const std::vector<double> facts = file.dataset(group + "/facts");
    paced.certificate = {static_cast<LimitCycleVerdict>(static_cast<int>(facts.at(0))), facts.at(1),
                         facts.at(2), facts.at(3), static_cast<int>(facts.at(4))};
    paced.calcium_min_uM = facts.at(5);
    paced.calcium_max_uM = facts.at(6);
    paced.charge_drift_mV = facts.at(7);
    paced.potential_max_mV = facts.at(8);
    cells_.emplace(name, std::move(paced));
  }
  build();
  driver_->restore(file.dataset("/checkpoint/driver"));
  search_->restore(file.dataset("/checkpoint/search"));
  certificate_ = search_->certificate();
  const std::vector<double> run = file.dataset("/checkpoint/run");
  cost_.beats = static_cast<int>(run.at(0));
  volume_drift_ = run.at(1);
  cost_.cells_s = run.at(2);
  cost_.heart_s = run.at(3);
  if (cost_.beats > 0) {
    trace_.clear_rows();
    for (Column& column : trace_.columns) column.values = file.dataset(place_of(column.name));
    const std::vector<double> audit = file.dataset("/checkpoint/audit");
    audit_.chamber_work_mmHg_mL = audit.at(0);
    audit_.dissipated_mmHg_mL = audit.at(1);
    audit_.blood_volume_change_mL = audit.at(2);
    audit_.volume_mismatch_mL = audit.at(3);
    audit_.newton_iterations = static_cast<long>(audit.at(4));
    audit_.most_newton_iterations = static_cast<int>(audit.at(5));
    for (int v = 0; v < n_valves; ++v) audit_.valve_volume_mL[v] = audit.at(6 + v);
  }
}

void HeartRun::advance(Progress::Style style, const std::optional<std::filesystem::path>& result) {
  const double heart_before = cost_.heart_s;
  const auto begin = Clock::now();
  auto last_checkpoint = begin;
  Progress progress("heart", style);
  const auto finished = [&] {
    return scene_.until_limit_cycle ? !search_->running() : cost_.beats >= scene_.beats;
  };
  std::vector<double> good = driver_->save();
  while (!finished()) {
    try {
      progress.update(scene_.until_limit_cycle ? -1.0 : static_cast<double>(cost_.beats) / scene_.beats,
                      fmt::format("beat {}, distance {:.1e}", cost_.beats, certificate_.distance));
    } catch (const Interrupted&) {
      if (!result) throw Interrupted("stopped on request; no -o was given, nothing was saved");
      write(*result);
      throw Interrupted(fmt::format("stopped on request after {} beats; continue with --resume {}",
                                    cost_.beats, result->string()));
    }
    const CirculationValues start = driver_->values();
    Table trace = driver_->trace();
    std::vector<double> proposal;
    try {
      const BeatAudit audit = driver_->beat(&trace);
      audit_ = audit;
    } catch (const NumericalFailure& failure) {
      // Keep the last good state; an extrapolated start that failed is given up for a plain one.
      driver_->restore(good);
      bool recovered = false;
      proposal = search_->after_failure(recovered);
      if (!recovered) {
        cost_.heart_s = heart_before + seconds_since(begin);
        if (result) write(*result);
        throw NumericalFailure(fmt::format(
            "beat {}: {}{}", cost_.beats + 1, failure.what(),
            result ? fmt::format(" The last good state is in {}.", result->string()) : std::string()));
      }
    }
    ++cost_.beats;
    if (proposal.empty()) {
      trace_ = std::move(trace);
      const CirculationValues& image = driver_->values();
      volume_drift_ = std::max(volume_drift_, std::abs(audit_.blood_volume_change_mL));
      proposal = search_->next({start.begin(), start.end()}, {image.begin(), image.end()});
    }
    certificate_ = search_->certificate();
    CirculationValues next;
    std::copy(proposal.begin(), proposal.end(), next.begin());
    if (next != driver_->values()) {
      hold_total_volume(scene_.circulation, next.data(), initial_volume_);
      driver_->move_to(next);
    }
    good = driver_->save();
    cost_.heart_s = heart_before + seconds_since(begin);
    if (result && !finished() && seconds_since(last_checkpoint) >= scene_.checkpoint_every_s) {
      write(*result);
      last_checkpoint = Clock::now();
    }
  }
  if (!scene_.until_limit_cycle)
    certificate_.verdict = certificate_.beats >= 3 && certificate_.distance <= scene_.limit_cycle.distance
                               ? LimitCycleVerdict::period_1
                               : LimitCycleVerdict::not_converged;
  complete_ = true;
  if (result) write(*result);
  progress.finish(fmt::format("{} beats, limit cycle: {}, distance {:.1e}", cost_.beats,
                              to_string(certificate_.verdict), certificate_.distance));
}

BeatIndexes HeartRun::indexes() const { return compute_indexes(trace_, atrial_stimulus_s(scene_)); }

void HeartRun::write(const std::filesystem::path& path) const {
  ResultWriter file;
  file.text("/provenance/status", complete_ ? "complete" : "incomplete");
  file.text("/provenance/scene", scene_.text);
  file.text("/provenance/title", scene_.title);
  file.text("/provenance/version", version_text());
  char host[256] = "";
  gethostname(host, sizeof host - 1);
  file.text("/provenance/host", host);
  file.scalar("/provenance/wall_time", cost_.cells_s + cost_.heart_s, "s", "wall time of cells and heart");

  if (cost_.beats > 0) {
    for (const Column& column : trace_.columns) {
      file.dataset(place_of(column.name), column.values, column.unit, column.meaning);
    }
    write_indexes(file, indexes(), scene_.body_surface_area_m2);
    file.text("/summary", summarise(*this).dump());
  }
  file.text("/limit_cycle/verdict", to_string(certificate_.verdict));
  file.scalar("/limit_cycle/distance", certificate_.distance, "1",
              "estimated scaled distance to the limit cycle");
  file.scalar("/limit_cycle/residual", certificate_.residual, "1", "scaled change over the last beat");
  file.scalar("/limit_cycle/multiplier", certificate_.multiplier, "1", "estimated leading multiplier");
  file.scalar("/limit_cycle/beats", certificate_.beats, "1", "beats of the coupled heart");
  file.scalar("/solver/newton_iterations", static_cast<double>(audit_.newton_iterations), "1",
              "in the last beat");
  file.scalar("/solver/steps", static_cast<double>(driver_->steps_per_beat()), "1", "per beat");
  file.scalar("/solver/cost_cells", cost_.cells_s, "s", "wall time of the cells' limit cycles");
  file.scalar("/solver/cost_heart", cost_.heart_s, "s", "wall time of the coupled heart");

  for (const auto& [name, paced] : cells_) {
    const std::string group = "/checkpoint/cells/" + name;
    if (!paced.state_at_onset.empty())
      file.dataset(group + "/state_at_onset", paced.state_at_onset, "model units", "state at stimulus onset");
    file.dataset(
        group + "/facts",
        {static_cast<double>(paced.certificate.verdict), paced.certificate.distance,
         paced.certificate.residual, paced.certificate.multiplier,
         static_cast<double>(paced.certificate.beats), paced.calcium_min_uM, paced.calcium_max_uM,
         paced.charge_drift_mV, paced.potential_max_mV},
        "mixed",
        "verdict, distance, residual, multiplier, beats, calcium range, charge drift, peak potential");
  }
  file.dataset("/checkpoint/driver", driver_->save(), "mixed", "circulation, pressures, flows, walls");
  file.dataset("/checkpoint/search", search_->save(), "mixed", "memory of the limit-cycle search");
  file.dataset("/checkpoint/run",
               {static_cast<double>(cost_.beats), volume_drift_, cost_.cells_s, cost_.heart_s}, "mixed",
               "beats, blood volume drift, costs");
  std::vector<double> audit = {audit_.chamber_work_mmHg_mL,
                               audit_.dissipated_mmHg_mL,
                               audit_.blood_volume_change_mL,
                               audit_.volume_mismatch_mL,
                               static_cast<double>(audit_.newton_iterations),
                               static_cast<double>(audit_.most_newton_iterations)};
  audit.insert(audit.end(), audit_.valve_volume_mL.begin(), audit_.valve_volume_mL.end());
  file.dataset("/checkpoint/audit", audit, "mixed", "audit of the last beat");
  file.write(path);
}

}  // namespace wiggers
