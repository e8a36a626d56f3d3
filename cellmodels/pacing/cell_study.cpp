#include <fmt/format.h>

#include <algorithm>
#include <wiggers/cellmodels/models/ionic_models.hpp>
#include <wiggers/cellmodels/pacing/beat_features.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/cellmodels/pacing/cell_study.hpp>
#include <wiggers/cellmodels/pacing/paced_beat.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/units.hpp>

namespace wiggers {

namespace {

constexpr Quantity charge_offset_quantity{
    "charge_offset_mV", "mV", 0, -1e6, 1e6, "charge of the cycle above that of the published state"};
constexpr int n_protocol = 4;  // period, amplitude, duration, charge

// Calls work<Model>() for the study's model.
template <class Work>
void with_model(const CellStudy& study, Work work) {
  bool found = false;
  IonicModels::each([&]<class Model>() {
    if (study.model->name != Model::name) return;
    found = true;
    work.template operator()<Model>();
  });
  if (!found) throw InputError(fmt::format("{} is no paced cell", study.model->name));
}

bool is_second_order(const CellStudy& study) {
  if (study.integrator == "rush-larsen-2") return true;
  if (study.integrator == "rush-larsen") return false;
  refuse_unknown("integrator of a cell's study", study.integrator,
                 std::vector<std::string>{"rush-larsen", "rush-larsen-2"});
}

// The beat at values (or seeded values) of cell_study_parameters.
template <class Model, class T>
PacedBeat<Model, T> beat_at(const CellStudy& study, const std::vector<T>& values) {
  const std::size_t n = study.model->parameters.size();
  PacedBeatInputs<T> in;
  in.parameters.assign(values.begin(), values.begin() + static_cast<long>(n));
  in.period_ms = values[n];
  in.amplitude_A_per_F = values[n + 1];
  in.duration_ms = values[n + 2];
  if constexpr (HasInvariants<Model>) {
    std::array<T, Model::states.size()> published;
    for (std::size_t i = 0; i < published.size(); ++i) published[i] = Model::states[i].default_value;
    const auto held = Model::invariant_values(published.data(), Model::constants(in.parameters.data()));
    in.invariants.assign(held.begin(), held.end());
    for (std::size_t k = 0; k < held.size(); ++k)
      if (Model::invariants[k].is_charge) in.invariants[k] += values[n + 3];
  }
  return {std::move(in), study.protocol.stimulus.onset_ms, study.dt_ms, is_second_order(study)};
}

std::vector<double> values_of(const CellStudy& study) {
  std::vector<double> values = study.parameters;
  values.insert(values.end(), {study.protocol.period_ms, study.protocol.stimulus.amplitude_A_per_F,
                               study.protocol.stimulus.duration_ms, study.charge_offset_mV});
  return values;
}

// Runs a beat and visits its indexes, the start's states included. Returns why it is no action potential.
// on_row(time, states) sees every row.
template <class Model, class T, class Visit, class OnRow>
std::string beat_indexes(const PacedBeat<Model, T>& beat, std::vector<T> state, Visit visit, OnRow on_row) {
  const std::vector<T> start = state;
  std::vector<T> t, V, calcium;
  beat.run(state.data(), [&](const T& time, const T* y) {
    t.push_back(time);
    V.push_back(y[potential_of<Model>]);
    if constexpr (calcium_of<Model> >= 0) calcium.push_back(y[calcium_of<Model>]);
    on_row(time, y);
  });
  visit_features(t, V, calcium, beat.stimulus_edges(), visit);
  for (std::size_t i = 0; i < start.size(); ++i)
    visit(fmt::format("start.{}", Model::states[i].name), std::string(Model::states[i].unit), start[i]);
  return no_action_potential(V);
}

FixedPointDerivatives cycle_derivatives(const CellStudy& study, const std::vector<double>& on_cycle,
                                        const std::vector<double>& values,
                                        const std::function<void(double)>& after_pass, double share) {
  require_limit_cycle(*study.model, study.parameters);
  const double passes = std::ceil(static_cast<double>(on_cycle.size() + values.size()) / tangent_lanes);
  double done = 0;
  FixedPointDerivatives derivatives;
  with_model(study, [&]<class Model>() {
    derivatives = fixed_point_derivatives(
        on_cycle, values, [&](std::vector<Tangent> state, const std::vector<Tangent>& parameter) {
          beat_at<Model, Tangent>(study, parameter).run(state.data(), [](const Tangent&, const Tangent*) {});
          if (after_pass) after_pass(share * ++done / passes);
          return state;
        });
  });
  return derivatives;
}

}  // namespace

CellStudy make_cell_study(const CellModel& model, std::string_view set) {
  if (!model.is_ionic())
    throw InputError(
        fmt::format("{} is a force model, not a paced cell: drive it by calcium and length", model.name));
  CellStudy study;
  study.model = &model;
  study.parameters = model.parameter_values(set);
  study.protocol = {pacing_period_quantity.default_value, model.default_stimulus};
  return study;
}

std::vector<NamedParameter> cell_study_parameters(const CellStudy& study) {
  std::vector<Quantity> quantities(study.model->parameters.begin(), study.model->parameters.end());
  quantities.insert(quantities.end(), {pacing_period_quantity, stimulus_amplitude_quantity,
                                       stimulus_duration_quantity, charge_offset_quantity});
  // The pulse's defaults are the model's.
  quantities[quantities.size() - 3].default_value = study.model->default_stimulus.amplitude_A_per_F;
  quantities[quantities.size() - 2].default_value = study.model->default_stimulus.duration_ms;
  const std::vector<double> values = values_of(study);
  std::vector<NamedParameter> list;
  for (std::size_t k = 0; k < values.size(); ++k)
    list.push_back({std::string(quantities[k].name), quantities[k], values[k]});
  return list;
}

void check_study(const CellStudy& study) {
  (void)is_second_order(study);
  check_protocol(*study.model, study.protocol, {study.integrator, 1e-8, 1e-10, study.dt_ms});
}

void set_cell_study_parameters(CellStudy& study, std::span<const double> values) {
  const std::vector<NamedParameter> list = cell_study_parameters(study);
  if (values.size() != list.size())
    throw InputError(fmt::format("{} has {} parameters with its pacing, {} values were given",
                                 study.model->name, list.size(), values.size()));
  for (std::size_t k = 0; k < list.size(); ++k) check_range(list[k].quantity, values[k], study.model->name);
  CellStudy changed = study;
  const std::size_t n = values.size() - n_protocol;
  changed.parameters.assign(values.begin(), values.begin() + static_cast<long>(n));
  changed.protocol.period_ms = values[n];
  changed.protocol.stimulus.amplitude_A_per_F = values[n + 1];
  changed.protocol.stimulus.duration_ms = values[n + 2];
  changed.charge_offset_mV = values[n + 3];
  check_study(changed);
  study = changed;
}

void set_cell_study_parameter(CellStudy& study, std::string_view name, double value) {
  std::vector<double> values = values_of(study);
  std::vector<Quantity> quantities;
  for (const NamedParameter& p : cell_study_parameters(study)) quantities.push_back(p.quantity);
  values[require_index(quantities, fmt::format("parameter of {}", study.model->name), name)] = value;
  set_cell_study_parameters(study, values);
}

void hold_charge(const CellStudy& study, std::vector<double>& state) {
  const std::vector<double> published = study.model->default_state();
  const double* p = study.parameters.data();
  std::vector<double> held = study.model->invariant_values(published.data(), p);
  if (const int charge = study.model->charge_invariant(); charge >= 0)
    held[static_cast<std::size_t>(charge)] += study.charge_offset_mV;
  study.model->hold_invariants(state.data(), p, held);
}

std::vector<double> start_of(const CellStudy& study) {
  std::vector<double> state = study.model->default_state();
  hold_charge(study, state);
  return state;
}

LimitCycleCertificate to_limit_cycle(const CellStudy& study, std::vector<double>& state,
                                     LimitCycleSettings settings,
                                     const std::function<void(const LimitCycleCertificate&)>& after_beat) {
  require_limit_cycle(*study.model, study.parameters);
  hold_charge(study, state);
  const PacedCell cell(*study.model, study.parameters, study.protocol,
                       {study.integrator, 1e-8, 1e-10, study.dt_ms});
  BeatMap map = cell.beat_map(state);
  with_model(study, [&]<class Model>() {
    map.beat = [&cell,
                beat = beat_at<Model, double>(study, values_of(study))](const std::vector<double>& start) {
      std::vector<double> image = start;
      long step = 0;
      beat.run(image.data(), [&](double t, const double* y) {
        if ((++step & 15) == 0) cell.check_range(t, y);
      });
      cell.check_range(0, image.data());
      return image;
    };
  });
  LimitCycleCertificate certificate = find_limit_cycle(map, settings, state, after_beat);
  if (certificate.verdict == LimitCycleVerdict::period_n) {
    std::vector<BeatPeaks> beats_of_cycle;
    std::vector<double> y = state;
    for (int k = 0; k < certificate.period; ++k) {
      const PacedRows rows = paced_rows(study, y);
      beats_of_cycle.push_back(peaks_of(rows.potential_mV, rows.calcium_mM));
      y = map.beat(y);
    }
    certificate.reason = words_of_beats(beats_of_cycle);
  }
  if (certificate.is_cycle()) judge_cell(certificate, unphysical_beats(study, state, certificate.period));
  return certificate;
}

std::string unphysical_beats(const CellStudy& study, std::vector<double> state, int beats) {
  CellSense sense(*study.model);
  with_model(study, [&]<class Model>() {
    const auto beat = beat_at<Model, double>(study, values_of(study));
    for (int k = 0; k < beats; ++k)
      beat.run(state.data(), [&](double t, const double* y) { sense.see(t, y); });
  });
  return sense.finding();
}

FixedPointDerivatives newton_at(const CellStudy& study, std::vector<double> state) {
  require_limit_cycle(*study.model, study.parameters);
  hold_charge(study, state);
  const std::vector<double> values = values_of(study);
  FixedPointDerivatives newton;
  with_model(study, [&]<class Model>() {
    newton = fixed_point_derivatives(state, {}, [&](std::vector<Tangent> x, const std::vector<Tangent>&) {
      beat_at<Model, Tangent>(study, {values.begin(), values.end()})
          .run(x.data(), [](const Tangent&, const Tangent*) {});
      return x;
    });
  });
  return newton;
}

std::vector<double> refined_limit_cycle(const CellStudy& study, std::vector<double> state,
                                        const FixedPointDerivatives& newton) {
  hold_charge(study, state);
  with_model(study, [&]<class Model>() {
    const auto beat = beat_at<Model, double>(study, values_of(study));
    state = refined_fixed_point(state, newton, [&](std::vector<double> x) {
      beat.run(x.data(), [](double, const double*) {});
      return x;
    });
  });
  return state;
}

std::vector<NamedValue> cell_indexes(const CellStudy& study, const std::vector<double>& start,
                                     BeatWords* words) {
  std::vector<NamedValue> list;
  CellSense sense(*study.model);
  with_model(study, [&]<class Model>() {
    std::string why_not = beat_indexes<Model, double>(
        beat_at<Model, double>(study, values_of(study)), start,
        [&](std::string name, std::string unit, double value) {
          list.push_back({std::move(name), std::move(unit), value});
        },
        [&](double t, const double* y) { sense.see(t, y); });
    if (words) *words = {std::move(why_not), sense.finding()};
  });
  return list;
}

Sensitivities cell_sensitivities(const CellStudy& study, const std::vector<double>& on_cycle,
                                 const std::function<void(double)>& after_pass) {
  const std::vector<double> values = values_of(study);
  const Eigen::MatrixXd moves = cycle_derivatives(study, on_cycle, values, after_pass, 0.6).moves;
  Sensitivities table;
  for (const NamedParameter& p : cell_study_parameters(study)) {
    table.parameters.push_back(p.name);
    table.parameter_units.emplace_back(p.quantity.unit);
  }
  const int m = static_cast<int>(values.size());
  for (int first = 0; first < m; first += tangent_lanes) {
    TangentPass pass = tangent_pass(on_cycle, values, moves, first);
    with_model(study, [&]<class Model>() {
      std::size_t index = 0;
      beat_indexes<Model, Tangent>(
          beat_at<Model, Tangent>(study, pass.parameter), pass.state,
          [&](const std::string& name, const std::string& unit, const Tangent& value) {
            store_output(table, first, index++, name, unit, value);
          },
          [](const Tangent&, const Tangent*) {});
    });
    if (after_pass) after_pass(0.6 + 0.4 * std::min(1.0, static_cast<double>(first + tangent_lanes) / m));
  }
  for (int i = 0; i < moves.rows(); ++i)
    for (int j = 0; j < m; ++j) table.state_derivatives.push_back(moves(i, j));
  for (std::size_t k = study.model->parameters.size(); k-- > 0;)
    if (study.model->parameters[k].role == Role::stimulus_share) table.leave_out(k);
  return table;
}

PacedRows paced_rows(const CellStudy& study, const std::vector<double>& start) {
  PacedRows rows;
  std::vector<double> state = start;
  with_model(study, [&]<class Model>() {
    beat_at<Model, double>(study, values_of(study)).run(state.data(), [&](double t, const double* y) {
      rows.t_ms.push_back(t);
      if constexpr (calcium_of<Model> >= 0) rows.calcium_mM.push_back(y[calcium_of<Model>]);
      rows.potential_mV.push_back(y[potential_of<Model>]);
    });
  });
  return rows;
}

PacedTangents::PacedTangents(const CellStudy& study, std::vector<double> on_cycle)
    : study_(study),
      state_(std::move(on_cycle)),
      moves_(cycle_derivatives(study, state_, values_of(study), {}, 1).moves) {}

PacedTrace PacedTangents::trace(int first) const {
  PacedTrace trace;
  TangentPass pass = tangent_pass(state_, values_of(study_), moves_, first);
  with_model(study_, [&]<class Model>() {
    beat_at<Model, Tangent>(study_, pass.parameter)
        .run(pass.state.data(), [&](const Tangent& t, const Tangent* y) {
          trace.t_ms.push_back(t);
          if constexpr (calcium_of<Model> >= 0) trace.calcium_mM.push_back(y[calcium_of<Model>]);
          trace.potential_mV.push_back(y[potential_of<Model>]);
        });
  });
  return trace;
}

}  // namespace wiggers
