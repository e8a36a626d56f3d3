#include <fmt/format.h>

#include <wiggers/cellmodels/pacing/cell_lanes.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/fixed_step.hpp>
#include <wiggers/core/rhythm.hpp>

namespace wiggers {

bool share_pacing(std::span<const CellStudy> studies) {
  for (const CellStudy& s : studies) {
    const CellStudy& first = studies.front();
    const StimulusPulse &a = s.protocol.stimulus, &b = first.protocol.stimulus;
    if (!s.model->keeps_invariants(s.parameters.data()) || s.model != first.model ||
        s.integrator != first.integrator || s.dt_ms != first.dt_ms ||
        s.protocol.period_ms != first.protocol.period_ms || a.amplitude_A_per_F != b.amplitude_A_per_F ||
        a.duration_ms != b.duration_ms || a.onset_ms != b.onset_ms)
      return false;
  }
  return true;
}

std::vector<LaneResult> to_limit_cycles_in_lanes(std::span<const CellStudy> studies,
                                                 std::vector<std::vector<double>> states,
                                                 const LimitCycleSettings& settings) {
  const CellStudy& shared = studies.front();
  const CellModel& model = *shared.model;
  CellPopulation cells(model, studies.size(), {.integrator = shared.integrator}, shared.parameters);
  for (std::size_t p = 0; p < model.parameters.size(); ++p) {
    std::vector<double> values;
    bool differs = false;
    for (const CellStudy& s : studies) {
      values.push_back(s.parameters[p]);
      differs = differs || s.parameters[p] != shared.parameters[p];
    }
    if (differs) cells.set_parameters(model.parameters[p].name, values);
  }
  struct Lane {
    std::unique_ptr<PacedCell> cell;
    BeatMap map;
    std::unique_ptr<LimitCycleSearch> search;
    std::unique_ptr<Rhythm> rhythm;  // of the plain beats
  };
  std::vector<Lane> lanes(studies.size());
  for (std::size_t k = 0; k < studies.size(); ++k) {
    hold_charge(studies[k], states[k]);
    lanes[k].cell =
        std::make_unique<PacedCell>(model, studies[k].parameters, studies[k].protocol,
                                    CellIntegrator{studies[k].integrator, 1e-8, 1e-10, studies[k].dt_ms});
    lanes[k].map = lanes[k].cell->beat_map(states[k]);
    lanes[k].search =
        std::make_unique<LimitCycleSearch>(settings, lanes[k].map.scales, lanes[k].map.positive);
    lanes[k].rhythm = std::make_unique<Rhythm>(lanes[k].map.scales);
    lanes[k].rhythm->see(states[k]);
  }
  const StimulusPulse& pulse = shared.protocol.stimulus;
  const auto span = [&](double length, double current) {
    const long n = whole_steps(length, shared.dt_ms);
    if (n < 1) return;
    cells.set_input(model.inputs.front().name, current);
    cells.step(length / static_cast<double>(n), static_cast<int>(n));
  };
  const auto running = [&] {
    for (const Lane& lane : lanes)
      if (lane.search->running()) return true;
    return false;
  };
  while (running()) {
    for (std::size_t k = 0; k < lanes.size(); ++k) cells.set_state_of(k, states[k]);
    span(pulse.onset_ms, 0);
    span(pulse.duration_ms, pulse.amplitude_A_per_F);
    span(shared.protocol.period_ms - pulse.onset_ms - pulse.duration_ms, 0);
    for (std::size_t k = 0; k < lanes.size(); ++k) {
      if (!lanes[k].search->running()) continue;
      std::vector<double> image = cells.state_of(k);
      hold_charge(studies[k], image);
      if (lanes[k].search->certificate().beats < settings.plain_beats) lanes[k].rhythm->see(image);
      states[k] = lanes[k].search->next(states[k], image);
      if (lanes[k].search->running()) lanes[k].map.admit(states[k]);
    }
  }
  std::vector<LaneResult> results;
  for (std::size_t k = 0; k < lanes.size(); ++k) {
    const LimitCycleSearch& search = *lanes[k].search;
    const bool settled =
        search.certificate().good() &&
        (settings.attractor == Attractor::any ||
         (lanes[k].rhythm->period() == 1 && search.suspicious_multiplier() < suspicious_multiplier));
    results.push_back({states[k], search.certificate(), settled});
  }
  return results;
}

}  // namespace wiggers
