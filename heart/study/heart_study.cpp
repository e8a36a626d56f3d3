#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/circulation/stiffness.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/indexes/indexes_of.hpp>
#include <wiggers/heart/run/paced_cells.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/scene/scene_keys.hpp>
#include <wiggers/heart/scene/wall_kind.hpp>
#include <wiggers/heart/study/heart_study.hpp>

namespace wiggers {

// The scene's numbers that carry derivatives.
template <class T>
struct HeartStudy::Numbers {
  T period_s;
  CirculationParametersOf<T> circulation;
  PericardiumOf<T> bag;
  T total_volume_mL;
  struct Cell {
    CalciumShapeOf<T> transient;
    T calcium_factor = 1;
    std::vector<T> ionic;  // as of cell_study_parameters
    std::vector<T> force;
  };
  std::map<std::string, Cell> cells;
  std::vector<std::vector<T>> walls;  // as the recipes list them
};

// visit(key, quantity, field), the same fields in the same order for any kind of number.
template <class AnyNumbers, class Visit>
void HeartStudy::for_each_number(AnyNumbers& n, Visit visit) const {
  visit("heart.period_s", period_quantity, n.period_s);
  for (auto& [name, cell] : n.cells) {
    const std::string at = "cells." + name + ".";
    const CellType& type = scene_.cells.at(name);
    if (type.ionic) {
      const std::span<const Quantity> ionic = type.ionic->parameters;
      for (std::size_t k = 0; k < ionic.size(); ++k)
        if (ionic[k].role != Role::stimulus_share)
          visit(at + "ionic_changes." + std::string(ionic[k].name), ionic[k], cell.ionic[k]);
      visit(at + "stimulus_A_per_F", stimulus_amplitude_quantity, cell.ionic[ionic.size() + 1]);
      visit(at + "stimulus_ms", stimulus_duration_quantity, cell.ionic[ionic.size() + 2]);
      visit(at + "calcium_factor", scene_keys::calcium_factor, cell.calcium_factor);
    } else {
      visit(at + "calcium_rest_uM", scene_keys::calcium_rest, cell.transient.rest_uM);
      visit(at + "calcium_peak_uM", scene_keys::calcium_peak, cell.transient.peak_uM);
      visit(at + "rise_ms", scene_keys::rise, cell.transient.rise_ms);
      visit(at + "decay_ms", scene_keys::decay, cell.transient.decay_ms);
    }
    const std::span<const Quantity> force = type.force->parameters;
    for (std::size_t k = 0; k < cell.force.size(); ++k)
      if (force[k].role != Role::strength)  // the wall's own
        visit(at + "force_changes." + std::string(force[k].name), force[k], cell.force[k]);
  }
  for (std::size_t w = 0; w < scene_.walls.size(); ++w) {
    const WallPlan& plan = scene_.walls[w];
    const std::vector<NamedParameter> numbers = plan.recipe->numbers(plan);
    for (std::size_t k = 0; k < numbers.size(); ++k)
      visit("walls." + plan.name + "." + numbers[k].name, numbers[k].quantity, n.walls[w][k]);
  }
  for_each_circulation_parameter(n.circulation,
                                 [&](const std::string& name, const Quantity& quantity, auto& field) {
                                   visit("circulation." + name, quantity, field);
                                 });
  if (n.bag.present()) {
    visit("pericardium.pressure_mmHg", scene_keys::bag_pressure, n.bag.pressure_mmHg);
    visit("pericardium.reference_volume_mL", scene_keys::bag_volume, n.bag.reference_volume_mL);
  }
  visit("circulation.initial.total_volume", total_volume_quantity, n.total_volume_mL);
}

HeartStudy::HeartStudy(Scene scene) : scene_(std::move(scene)) {
  for (const WallPlan& wall : scene_.walls)
    if (!wall.recipe->carries_derivatives())
      throw InputError(fmt::format(
          "walls.{}: a study has no equations for {} walls; use reduced, triseg or elastance walls",
          wall.name, wall.kind));
  for (const auto& [name, cell] : scene_.cells)
    if (cell.ionic && !cell.from_limit_cycle)
      throw InputError(
          fmt::format("cells.{}.start = \"published\": a study has its cells on their limit cycles", name));
  steps_ = {std::round(scene_.period_s / scene_.dt_s), scene_.dt_s, scene_.regulatory_substep_us};
}

HeartStudy HeartStudy::copy() const {
  HeartStudy other(scene_);
  other.steps_ = steps_;
  other.cells_ = cells_;
  other.between_beats_ = between_beats_;
  return other;
}

template <class T>
HeartStudy::Numbers<T> HeartStudy::numbers() const {
  Numbers<double> plain;
  plain.period_s = scene_.period_s;
  plain.circulation = scene_.circulation;
  plain.bag = scene_.pericardium;
  plain.total_volume_mL = total_volume(scene_.circulation, scene_.initial.data());
  for (const auto& [name, type] : scene_.cells) {
    Numbers<double>::Cell cell;
    cell.transient = type.transient;
    cell.calcium_factor = type.rescaling.factor;
    cell.force = type.force_parameters;
    if (type.ionic) {
      cell.ionic = type.ionic_parameters;
      cell.ionic.insert(cell.ionic.end(), {scene_.period_s * units::ms_per_s, type.stimulus.amplitude_A_per_F,
                                           type.stimulus.duration_ms, 0.0});
    }
    plain.cells.emplace(name, cell);
  }
  for (const WallPlan& plan : scene_.walls) {
    plain.walls.emplace_back();
    for (const NamedParameter& number : plan.recipe->numbers(plan))
      plain.walls.back().push_back(number.value);
  }
  if constexpr (std::is_same_v<T, double>) {
    return plain;
  } else {
    Numbers<T> result;
    result.circulation = converted<T>(plain.circulation);
    result.bag = {plain.bag.pressure_mmHg, plain.bag.reference_volume_mL, plain.bag.exponent};
    for (const auto& [name, cell] : plain.cells) {
      typename Numbers<T>::Cell lifted;
      lifted.ionic.assign(cell.ionic.begin(), cell.ionic.end());
      lifted.force.assign(cell.force.begin(), cell.force.end());
      result.cells.emplace(name, std::move(lifted));
    }
    for (const auto& wall : plain.walls) result.walls.emplace_back(wall.begin(), wall.end());
    std::vector<double> values;
    for_each_number(plain,
                    [&](const std::string&, const Quantity&, double value) { values.push_back(value); });
    std::size_t k = 0;
    for_each_number(result, [&](const std::string&, const Quantity&, T& field) { field = values[k++]; });
    return result;
  }
}

std::vector<NamedParameter> HeartStudy::parameters() const {
  std::vector<NamedParameter> list;
  auto plain = numbers<double>();
  for_each_number(plain, [&](const std::string& name, const Quantity& quantity, double value) {
    list.push_back({name, quantity, value});
  });
  return list;
}

// Steps and sub-steps divide another period into the same numbers of parts, so that what depends on the
// period does so smoothly; into more where they would be longer than the circulation is stable at.
void HeartStudy::divide_period(double period_s, std::vector<std::pair<std::string, double>>& changes) const {
  double bound = largest_filling_step(scene_.circulation).step_s;
  if (!scene_.implicit_inductors) bound = std::min(bound, largest_explicit_step(scene_.circulation));
  double parts = steps_.a_period;
  if (period_s / parts > bound) parts = std::ceil(period_s / (0.5 * bound));
  const double dt_s = period_s / parts;
  changes.emplace_back("solver.dt_s", dt_s);
  changes.emplace_back("solver.regulatory_substep_us", steps_.substep_us * (dt_s / steps_.dt_s));
}

void HeartStudy::set_parameters(std::span<const double> values) {
  const std::vector<NamedParameter> list = parameters();
  if (values.size() != list.size())
    throw InputError(
        fmt::format("this heart has {} parameters, {} values were given", list.size(), values.size()));
  std::vector<std::pair<std::string, double>> changes;
  for (std::size_t k = 0; k < values.size(); ++k) {
    check_range(list[k].quantity, values[k], list[k].name);
    if (values[k] == list[k].value) continue;
    changes.emplace_back(list[k].name, values[k]);
    if (list[k].name == "heart.period_s") divide_period(values[k], changes);
  }
  if (changes.empty()) return;
  Scene changed = with_numbers(scene_, changes);
  // Cells keep their cycles where nothing that moves them has changed.
  std::erase_if(cells_, [&](const auto& entry) {
    const CellType& now = changed.cells.at(entry.first);
    const CellStudy& was = entry.second.study;
    return changed.period_s != scene_.period_s || now.ionic_parameters != was.parameters ||
           now.stimulus.amplitude_A_per_F != was.protocol.stimulus.amplitude_A_per_F ||
           now.stimulus.duration_ms != was.protocol.stimulus.duration_ms;
  });
  scene_ = std::move(changed);
  driver_.reset();
}

void HeartStudy::set_parameter(std::string_view name, double value) {
  std::vector<std::string> names;
  std::vector<double> values;
  for (const NamedParameter& p : parameters()) {
    names.push_back(p.name);
    values.push_back(p.value);
  }
  const auto found = std::find(names.begin(), names.end(), name);
  if (found == names.end()) refuse_unknown("parameter of the heart", name, names);
  values[static_cast<std::size_t>(found - names.begin())] = value;
  set_parameters(values);
}

void HeartStudy::solve_cells() {
  for (const auto& [name, type] : scene_.cells) {
    if (!type.ionic || cells_.count(name)) continue;
    SolvedCell cell;
    cell.study.model = type.ionic;
    cell.study.parameters = type.ionic_parameters;
    cell.study.protocol = {scene_.period_s * units::ms_per_s, type.stimulus};
    cell.study.dt_ms = scene_.electrophysiology_substep_ms;
    cell.study.integrator = scene_.electrophysiology_integrator;
    cell.state = start_of(cell.study);
    LimitCycleSettings settings;
    settings.attractor = Attractor::paced;
    const LimitCycleCertificate certificate =
        wiggers::to_limit_cycle(cell.study, cell.state, settings, between_beats_);
    require_one_beat_cycle(certificate, name, *type.ionic, scene_.period_s);
    cell.state = refined_limit_cycle(cell.study, cell.state, wiggers::newton_at(cell.study, cell.state));
    const PacedRows rows = paced_rows(cell.study, cell.state);
    cell.raw.t_ms = rows.t_ms;
    for (double value : rows.calcium_mM) cell.raw.calcium_uM.push_back(units::uM_per_mM * value);
    cells_.emplace(name, std::move(cell));
  }
}

void HeartStudy::differentiate(SolvedCell& cell) const {
  if (!cell.calcium_derivatives.empty()) return;
  const PacedTangents tangents(cell.study, cell.state);
  const std::size_t m = cell_study_parameters(cell.study).size(), n = cell.raw.t_ms.size();
  cell.calcium_derivatives.assign(n * m, 0.0);
  cell.time_derivatives.assign(n * m, 0.0);
  for (std::size_t first = 0; first < m; first += tangent_lanes) {
    const PacedTrace trace = tangents.trace(static_cast<int>(first));
    for (std::size_t row = 0; row < n; ++row)
      for (std::size_t k = 0; k < tangent_lanes && first + k < m; ++k) {
        cell.calcium_derivatives[row * m + first + k] =
            units::uM_per_mM * trace.calcium_mM[row].derivative[k];
        cell.time_derivatives[row * m + first + k] = trace.t_ms[row].derivative[k];
      }
  }
}

// Every cell type's calcium at the force model's door.
template <class T>
HeartStudy::CalciumOf<T> HeartStudy::calcium(const Numbers<T>& n) {
  solve_cells();
  CalciumOf<T> result;
  for (auto& [name, cell] : cells_) {
    auto cycle = std::make_shared<CalciumCycle<T>>();
    cycle->t_ms.assign(cell.raw.t_ms.begin(), cell.raw.t_ms.end());
    cycle->calcium_uM.assign(cell.raw.calcium_uM.begin(), cell.raw.calcium_uM.end());
    const auto& ionic = n.cells.at(name).ionic;
    if constexpr (!std::is_same_v<T, double>) {
      // By the chain rule from the cell's own derivatives.
      for (std::size_t j = 0; j < ionic.size(); ++j) {
        const auto& seeds = ionic[j].derivative;
        if (std::all_of(seeds.begin(), seeds.end(), [](double s) { return s == 0; })) continue;
        differentiate(cell);
        for (std::size_t row = 0; row < cell.raw.t_ms.size(); ++row)
          for (int k = 0; k < tangent_lanes; ++k) {
            cycle->calcium_uM[row].derivative[k] +=
                cell.calcium_derivatives[row * ionic.size() + j] * seeds[k];
            cycle->t_ms[row].derivative[k] += cell.time_derivatives[row * ionic.size() + j] * seeds[k];
          }
      }
    }
    const T factor = n.cells.at(name).calcium_factor;
    const T diastolic = *std::min_element(cycle->calcium_uM.begin(), cycle->calcium_uM.end());
    const bool peak = scene_.cells.at(name).rescaling.reading == CalciumReading::peak;
    for (T& value : cycle->calcium_uM)
      value = peak ? T(diastolic + factor * (value - diastolic)) : T(factor * value);
    cycle->lowest_uM = peak ? diastolic : T(factor * diastolic);
    result.emplace(name, std::move(cycle));
  }
  return result;
}

template <class T>
std::unique_ptr<HeartDriverOf<T>> HeartStudy::build(const Numbers<T>& n, const CalciumOf<T>& calcium) const {
  std::vector<std::unique_ptr<WallOf<T>>> walls;
  const T period_ms = units::ms_per_s * n.period_s;
  const WallSiteOf<T> site = {
      scene_, n.period_s,
      [&](const FibrePlan& fibre, const T& activation_ms, const T& strength_kPa, const std::string& place) {
        const auto& cell = n.cells.at(fibre.cells);
        std::unique_ptr<CellSourceOf<T>> source;
        T rest = cell.transient.rest_uM;
        if (scene_.cells.at(fibre.cells).ionic) {
          source = std::make_unique<CyclicCalcium<T>>(calcium.at(fibre.cells), period_ms, activation_ms);
          rest = calcium.at(fibre.cells)->lowest_uM;
        } else {
          source = std::make_unique<PrescribedCalciumOf<T>>(cell.transient, period_ms, activation_ms);
        }
        std::vector<T> force = cell.force;
        force[static_cast<std::size_t>(fibre.force->parameter(Role::strength))] = strength_kPa;
        return ActiveFibreOf<T>(fibre.settings, *fibre.force, force, rest, std::move(source), place);
      }};
  for (std::size_t w = 0; w < scene_.walls.size(); ++w)
    walls.push_back(scene_.walls[w].recipe->make(scene_.walls[w], site, std::span<const T>(n.walls[w])));
  const double steps = std::round(scene_.period_s / scene_.dt_s);
  return std::make_unique<HeartDriverOf<T>>(
      DriverSettingsOf<T>{n.period_s, T(n.period_s / steps), scene_.stabilise_volumes,
                          scene_.implicit_inductors, n.bag},
      n.circulation, std::move(walls));
}

HeartDriver& HeartStudy::driver() {
  if (!driver_) {
    const auto plain = numbers<double>();
    driver_ = build<double>(plain, calcium<double>(plain));
  }
  return *driver_;
}

HeartState HeartStudy::to_limit_cycle(const LimitCycleSettings& wanted, const HeartState* near,
                                      const std::function<void(const LimitCycleCertificate&)>& after_beat) {
  if (!near) driver_.reset();  // a start from the scene owes nothing to earlier beats
  if (near) check_size(*near);
  HeartDriver& heart = driver();
  PhysicalSense sense;  // of the latest beat
  const double volume = total_volume(scene_.circulation, scene_.initial.data());
  heart.start(scene_.initial);
  LimitCycleSettings settings = wanted;
  if (near) {
    std::vector<double> state = near->driver;
    hold_total_volume(scene_.circulation, state.data(), volume);
    heart.restore(state);
    settings.plain_beats = std::min(settings.plain_beats, 1);
  }
  LimitCycleSearch search(settings, circulation_scales());
  std::vector<double> good = heart.save();
  while (search.running()) {
    const CirculationValues start = heart.values();
    std::vector<double> proposal;
    try {
      sense = {};
      heart.beat_rows([&](double t) { heart.show(t, sense); });
      const CirculationValues& image = heart.values();
      proposal = search.next({start.begin(), start.end()}, {image.begin(), image.end()});
    } catch (const NumericalFailure&) {
      // An extrapolated start that failed is given up for a plain one.
      heart.restore(good);
      bool recovered = false;
      proposal = search.after_failure(recovered);
      if (!recovered) throw;
    }
    CirculationValues next;
    std::copy(proposal.begin(), proposal.end(), next.begin());
    if (next != heart.values()) {
      hold_total_volume(scene_.circulation, next.data(), volume);
      heart.move_to(next);
    }
    good = heart.save();
    if (after_beat) after_beat(search.certificate());
  }
  LimitCycleCertificate certificate = search.certificate();
  if (certificate.good() && sense.finding()) {
    certificate.verdict = LimitCycleVerdict::unphysical;
    certificate.reason = sense.finding()->text();
  }
  return {heart.save(), certificate};
}

void HeartStudy::check_size(const HeartState& state) {
  const std::size_t wanted = driver().save().size();
  if (state.driver.size() != wanted)
    throw InputError(fmt::format("the state has {} numbers, this heart's has {}: it is of another scene",
                                 state.driver.size(), wanted));
}

std::unique_ptr<HeartDriverOf<Tangent>> HeartStudy::moving_heart(const std::vector<std::size_t>& active,
                                                                 const std::vector<Tangent>& parameter,
                                                                 Tangent& volume,
                                                                 AtrialActivationsOf<Tangent>& atria) {
  auto n = numbers<Tangent>();
  std::size_t index = 0, next = 0;
  for_each_number(n, [&](const std::string&, const Quantity&, Tangent& field) {
    if (next < active.size() && active[next] == index) field = parameter[next++];
    ++index;
  });
  // The pacing's period is the heart's.
  for (auto& [name, cell] : n.cells)
    if (!cell.ionic.empty()) cell.ionic[cell.ionic.size() - 4] = units::ms_per_s * n.period_s;
  volume = n.total_volume_mL;
  // Those of the scene, moving with the parameters.
  const AtrialActivations plain = atrial_activations_s(scene_);
  for (int side = 0; side < 2; ++side) {
    atria[side].reset();
    if (!plain[side]) continue;
    const int chamber = side == 0 ? LA : RA;
    for (std::size_t w = 0; w < scene_.walls.size(); ++w) {
      const WallPlan& plan = scene_.walls[w];
      if (std::find(plan.cavities.begin(), plan.cavities.end(), chamber) == plan.cavities.end()) continue;
      const auto k = plan.recipe->activation_number(plan, chamber);
      if (!k) continue;
      const Tangent& onset = n.walls[w][*k];
      const bool in_ms = plan.recipe->numbers(plan)[*k].quantity.unit == "ms";
      atria[side] = wrapped(in_ms ? Tangent(units::s_per_ms * onset) : onset, n.period_s);
    }
  }
  return build<Tangent>(n, calcium<Tangent>(n));
}

FixedPointDerivatives HeartStudy::cycle_derivatives(const std::vector<double>& state,
                                                    const std::vector<std::size_t>& active,
                                                    const std::function<void(double)>& after_pass) {
  std::vector<double> values;
  const auto all = parameters();
  for (std::size_t index : active) values.push_back(all[index].value);
  const double passes = std::ceil(static_cast<double>(state.size() + values.size()) / tangent_lanes);
  double done = 0;
  return fixed_point_derivatives(
      state, values, [&](const std::vector<Tangent>& start, const std::vector<Tangent>& parameter) {
        Tangent volume;
        AtrialActivationsOf<Tangent> atria;
        const auto heart = moving_heart(active, parameter, volume, atria);
        heart->restore(start);
        heart->beat_rows([](const Tangent&) {});
        std::vector<Tangent> image = heart->save();
        hold_total_volume(heart->circulation(), image.data(), volume);
        if (after_pass) after_pass(++done / passes);
        return image;
      });
}

FixedPointDerivatives HeartStudy::newton_at(const HeartState& state) {
  check_size(state);
  return cycle_derivatives(state.driver, {}, {});
}

HeartState HeartStudy::refined(const HeartState& state, const FixedPointDerivatives& derivatives) {
  check_size(state);
  HeartDriver& heart = driver();
  const double volume = total_volume(scene_.circulation, scene_.initial.data());
  std::vector<double> start = state.driver;
  hold_total_volume(scene_.circulation, start.data(), volume);
  return {refined_fixed_point(start, derivatives,
                              [&](const std::vector<double>& x) {
                                heart.restore(x);
                                heart.beat(nullptr);
                                std::vector<double> image = heart.save();
                                hold_total_volume(scene_.circulation, image.data(), volume);
                                return image;
                              }),
          state.certificate};
}

BeatIndexes HeartStudy::indexes(const HeartState& state) {
  check_size(state);
  HeartDriver& heart = driver();
  heart.restore(state.driver);
  BeatTraceOf<double> trace;
  heart.beat_rows([&](const double& t) {
    trace.append(heart.circulation(), t, heart.values().data(), heart.pressures().data(), heart.flows());
  });
  return compute_indexes_of(trace, atrial_activations_s(scene_), valve_debounce_s);
}

std::vector<std::string> HeartStudy::warnings(const HeartState& on_cycle) {
  HeartState same = on_cycle;
  const Table rows = beat(same);
  return verdict_warnings(rows, compute_indexes(rows, atrial_activations_s(scene_)));
}

Table HeartStudy::beat(HeartState& state) {
  check_size(state);
  HeartDriver& heart = driver();
  heart.restore(state.driver);
  Table table = heart.trace();
  heart.beat(&table);
  state.driver = heart.save();
  return table;
}

Sensitivities HeartStudy::sensitivities(const HeartState& on_cycle, const std::vector<std::string>& wanted,
                                        const std::function<void(double)>& after_pass) {
  check_size(on_cycle);
  const auto all = parameters();
  std::vector<std::string> names;
  for (const NamedParameter& p : all) names.push_back(p.name);
  std::vector<std::size_t> active;
  for (const std::string& name : wanted.empty() ? names : wanted) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) refuse_unknown("parameter of the heart", name, names);
    active.push_back(static_cast<std::size_t>(found - names.begin()));
  }
  std::sort(active.begin(), active.end());
  active.erase(std::unique(active.begin(), active.end()), active.end());
  Sensitivities table;
  std::vector<double> values;
  for (std::size_t index : active) {
    table.parameters.push_back(all[index].name);
    table.parameter_units.emplace_back(all[index].quantity.unit);
    values.push_back(all[index].value);
  }
  const auto report = [&](double share) {
    if (after_pass) after_pass(share);
  };
  const Eigen::MatrixXd moves =
      cycle_derivatives(on_cycle.driver, active, [&](double share) { report(0.7 * share); }).moves;
  const int m = static_cast<int>(active.size());
  for (int first = 0; first < m; first += tangent_lanes) {
    const TangentPass pass = tangent_pass(on_cycle.driver, values, moves, first);
    Tangent volume;
    AtrialActivationsOf<Tangent> atria;
    const auto heart = moving_heart(active, pass.parameter, volume, atria);
    heart->restore(pass.state);
    BeatTraceOf<Tangent> trace;
    heart->beat_rows([&](const Tangent& t) {
      trace.append(heart->circulation(), t, heart->values().data(), heart->pressures().data(),
                   heart->flows());
    });
    std::size_t index = 0;
    for_each_index(compute_indexes_of(trace, atria, valve_debounce_s),
                   [&](const std::string& name, const char* unit, const Tangent& value) {
                     store_output(table, first, index++, name, unit, value);
                   });
    report(0.7 + 0.3 * std::min(1.0, static_cast<double>(first + tangent_lanes) / m));
  }
  for (int i = 0; i < n_circulation_states; ++i)
    for (int j = 0; j < m; ++j) table.state_derivatives.push_back(moves(i, j));
  return table;
}

}  // namespace wiggers
