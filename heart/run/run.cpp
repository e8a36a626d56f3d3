#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/circulation/physical_sense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/result_file.hpp>
#include <wiggers/core/saved_numbers.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/provenance.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/run/summary.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>

namespace wiggers {

namespace {

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

}  // namespace

std::filesystem::path fields_folder(const std::filesystem::path& result, const std::string& name) {
  std::string base = result.string();
  if (base.ends_with(".h5")) base.resize(base.size() - 3);
  return base + "." + name + ".fields";
}

HeartRun::HeartRun(Scene scene) : scene_(std::move(scene)) {
  if (scene_.physics != Physics::heart)
    throw InputError("this needs a heart in the closed loop; a [body] of tissue alone is for wiggers run");
}

void HeartRun::prepare(Progress::Style style) {
  const auto begin = Clock::now();
  tissue_services().quiet = style == Progress::Style::quiet;
  cells_ = pace_cells(scene_, style);
  build();
  driver_->start(scene_.initial);
  cost_.cells_s = seconds_since(begin);
}

ActiveFibre HeartRun::make_fibre(const FibrePlan& plan, double activation_ms, double strength_kPa,
                                 const std::string& place) const {
  const CellType& type = scene_.cells.at(plan.cells);
  const PacedCellType& paced = cells_.at(plan.cells);
  const double period_ms = scene_.period_s * units::ms_per_s;
  std::unique_ptr<CellSource> source;
  if (type.ionic) {
    CalciumRescaling rescaling = type.rescaling;
    if (rescaling.reading == CalciumReading::peak) rescaling.diastolic_uM = paced.calcium_min_uM;
    source = std::make_unique<IonicCellSource>(
        *type.ionic, type.ionic_parameters, paced.state_at_onset,
        IonicCellSource::Pacing{period_ms, activation_ms, type.stimulus, scene_.electrophysiology_integrator,
                                scene_.electrophysiology_substep_ms},
        rescaling);
  } else {
    source = std::make_unique<PrescribedCalcium>(type.transient, period_ms, activation_ms);
  }
  std::vector<double> force = plan.force_parameters;
  force[static_cast<std::size_t>(plan.force->parameter(Role::strength))] = strength_kPa;
  return ActiveFibre(plan.settings, *plan.force, force, paced.calcium_min_uM, std::move(source), place);
}

void HeartRun::build() {
  std::vector<std::unique_ptr<Wall>> walls;
  const WallSiteOf<double> site = {
      scene_, scene_.period_s,
      [this](const FibrePlan& plan, const double& activation_ms, const double& strength_kPa,
             const std::string& place) { return make_fibre(plan, activation_ms, strength_kPa, place); },
      &cells_};
  for (const WallPlan& plan : scene_.walls) {
    std::vector<double> values;
    for (const NamedParameter& number : plan.recipe->numbers(plan)) values.push_back(number.value);
    walls.push_back(plan.recipe->make(plan, site, values));
    long_beats_ = long_beats_ || plan.recipe->in_space();
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
  require_same_scene(file, path, scene_.text());
  constexpr long most = std::numeric_limits<int>::max();
  const auto numbers = [&](const std::string& entry) {
    return SavedNumbers(file.dataset(entry), file.place(entry));
  };
  for (const auto& [name, cell] : scene_.cells) {
    const std::string group = "/checkpoint/cells/" + name;
    PacedCellType paced;
    if (cell.ionic) {
      paced.state_at_onset = file.finite(group + "/state_at_onset", cell.ionic->states.size());
      require_saved_state(*cell.ionic, cell.ionic_parameters, 0, paced.state_at_onset,
                          file.place(group + "/state_at_onset"));
    }
    SavedNumbers facts = numbers(group + "/facts");
    take_verdict(facts, paced.certificate);
    paced.certificate.distance = facts.not_negative();
    paced.certificate.residual = facts.not_negative();
    paced.certificate.multiplier = facts.not_negative();
    paced.certificate.beats = static_cast<int>(facts.count(most));
    paced.calcium_min_uM = facts.not_negative();
    paced.calcium_max_uM = facts.not_negative();
    paced.charge_drift_mV = facts.number();
    paced.potential_max_mV = facts.number();
    paced.calcium_max_where_chosen_uM = facts.not_negative();
    facts.finish();
    cells_.emplace(name, std::move(paced));
  }
  build();
  const std::vector<double> driver_state = file.finite("/checkpoint/driver");
  try {
    driver_->restore(driver_state);
  } catch (const InputError& error) {
    throw InputError(fmt::format("{}: {}", file.place("/checkpoint/driver"), error.what()));
  }
  const auto require_blood = [&](double volume_mL, const std::string& entry) {
    require_same_blood(volume_mL, initial_volume_, file.place(entry));
  };
  require_blood(total_volume(scene_.circulation, driver_->values().data()), "/checkpoint/driver");
  search_->restore(numbers("/checkpoint/search"));
  certificate_ = search_->certificate();
  SavedNumbers run = numbers("/checkpoint/run");
  cost_.beats = static_cast<int>(run.count(most));
  if (cost_.beats != certificate_.beats)
    run.refuse(fmt::format("{} beats, its search has seen {}", cost_.beats, certificate_.beats));
  volume_drift_ = run.not_negative();
  cost_.cells_s = run.not_negative();
  cost_.heart_s = run.not_negative();
  run.finish();
  if (file.has("/checkpoint/beat_under_way")) {
    SavedNumbers in = numbers("/checkpoint/beat_under_way");
    beat_ = std::make_unique<BeatUnderWay>();
    beat_->trace = driver_->trace();
    beat_->steps = in.count(driver_->steps_per_beat() - 1);
    beat_->blood_volume_mL = in.number();
    require_blood(beat_->blood_volume_mL, "/checkpoint/beat_under_way");
    BeatAudit& a = beat_->audit;
    a.chamber_work_mmHg_mL = in.number();
    a.dissipated_mmHg_mL = in.number();
    a.volume_mismatch_mL = in.not_negative();
    a.newton_iterations = in.count(most);
    a.most_newton_iterations = static_cast<int>(in.count(most));
    for (double& volume : a.valve_volume_mL) volume = in.number();
    for (double& value : beat_start_) value = in.number();
    require_blood(total_volume(scene_.circulation, beat_start_.data()), "/checkpoint/beat_under_way");
    const long rows = driver_->rows_after(beat_->steps);
    for (Column& column : beat_->trace.columns) column.values = in.numbers(static_cast<std::size_t>(rows));
    in.finish();
  }
  if (cost_.beats > 0) {
    trace_.clear_rows();
    const auto rows = static_cast<std::size_t>(driver_->rows_after(driver_->steps_per_beat()));
    for (Column& column : trace_.columns) column.values = file.finite(place_of(column.name), rows);
    SavedNumbers audit = numbers("/checkpoint/audit");
    audit_.chamber_work_mmHg_mL = audit.number();
    audit_.dissipated_mmHg_mL = audit.number();
    audit_.blood_volume_change_mL = audit.number();
    audit_.volume_mismatch_mL = audit.not_negative();
    audit_.newton_iterations = audit.count(most);
    audit_.most_newton_iterations = static_cast<int>(audit.count(most));
    for (double& volume : audit_.valve_volume_mL) volume = audit.number();
    audit.finish();
  }
}

void HeartRun::checkpoint(const std::filesystem::path& path) {
  collect_wall_figures();
  const std::vector<double> state = driver_->save();
  write(path, state);
  // What goes on is what a resumed run would go on with, bit for bit: also without the warm starts.
  driver_->restore(state);
}

void HeartRun::open_fields(const std::filesystem::path& result, bool resumed) {
  std::string base = result.string();
  if (base.ends_with(".h5")) base.resize(base.size() - 3);
  for (const auto& wall : driver_->walls()) wall->open_fields(base, resumed ? time_s() : -1);
}

double HeartRun::time_s() const {
  return (cost_.beats +
          (beat_ ? static_cast<double>(beat_->steps) / static_cast<double>(driver_->steps_per_beat()) : 0)) *
         scene_.period_s;
}

BeatIndexes HeartRun::indexes() const { return compute_indexes(trace_, atrial_activations_s(scene_)); }

void HeartRun::collect_wall_figures() {
  for (std::size_t w = 0; w < scene_.walls.size(); ++w) {
    std::map<std::string, WallFigure> figures;
    driver_->walls()[w]->report(figures);
    if (!figures.empty()) wall_figures_[scene_.walls[w].name] = std::move(figures);
  }
}

void HeartRun::write(const std::filesystem::path& path, const std::vector<double>& driver_state) const {
  // One rank writes; if it fails, all know.
  tissue_services().on_first_rank([&] { write_file(path, driver_state); });
}

void HeartRun::write_file(const std::filesystem::path& path, const std::vector<double>& driver_state) const {
  ResultWriter file;
  write_provenance(file, scene_.title, scene_.text(), complete_, cost_.cells_s + cost_.heart_s);

  // A run that was ended within a beat shows the rows of it.
  if (cost_.beats > 0 || complete_)
    for (const Column& column : trace_.columns)
      file.dataset(place_of(column.name), column.values, column.unit, column.meaning);
  for (const network::Branch& valve : network::valves) {
    const std::string group = fmt::format("/network/{}", valve.name);
    file.text(group + "/from", std::string(network::node_name(valve.from)));
    file.text(group + "/to", std::string(network::node_name(valve.to)));
  }
  if (has_whole_beat()) write_indexes(file, indexes(), scene_.body_surface_area_m2);
  if (cost_.beats > 0 || complete_) file.text("/summary", summarise(*this).dump());
  file.text("/limit_cycle/verdict", certificate_.text());
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
    file.dataset(group + "/facts",
                 {saved_verdict(paced.certificate), paced.certificate.distance, paced.certificate.residual,
                  paced.certificate.multiplier, static_cast<double>(paced.certificate.beats),
                  paced.calcium_min_uM, paced.calcium_max_uM, paced.charge_drift_mV, paced.potential_max_mV,
                  paced.calcium_max_where_chosen_uM},
                 "mixed",
                 "verdict, distance, residual, multiplier, beats, calcium range, charge drift, peak "
                 "potential, peak calcium "
                 "where the factor was chosen");
  }
  file.dataset("/checkpoint/driver", driver_state, "mixed", "circulation, pressures, flows, walls");
  if (beat_) {
    const BeatAudit& a = beat_->audit;
    std::vector<double> under_way = {static_cast<double>(beat_->steps),
                                     beat_->blood_volume_mL,
                                     a.chamber_work_mmHg_mL,
                                     a.dissipated_mmHg_mL,
                                     a.volume_mismatch_mL,
                                     static_cast<double>(a.newton_iterations),
                                     static_cast<double>(a.most_newton_iterations)};
    under_way.insert(under_way.end(), a.valve_volume_mL.begin(), a.valve_volume_mL.end());
    under_way.insert(under_way.end(), beat_start_.begin(), beat_start_.end());
    for (const Column& column : beat_->trace.columns)
      under_way.insert(under_way.end(), column.values.begin(), column.values.end());
    file.dataset("/checkpoint/beat_under_way", under_way, "mixed",
                 "step, audit, start and rows of a beat not yet done");
  }
  for (const auto& [wall, figures] : wall_figures_)
    for (const auto& [name, figure] : figures)
      file.scalar("/solver/walls/" + wall + "/" + name, figure.value, figure.unit, figure.meaning);
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
