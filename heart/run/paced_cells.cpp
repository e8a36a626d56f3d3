#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <wiggers/cellmodels/pacing/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/paced_cells.hpp>

namespace wiggers {

namespace {

PacedCell make_paced_cell(const Scene& scene, const CellType& cell, double period_s) {
  return PacedCell(*cell.ionic, cell.ionic_parameters, {period_s * units::ms_per_s, cell.stimulus},
                   {scene.electrophysiology_integrator, 1e-8, 1e-10, scene.electrophysiology_substep_ms});
}

// Peak calcium (rescaled, uM) at the period for which a cell's calcium_factor was chosen; 0 if that is the
// scene's own, or not said, or without a cycle.
double calcium_where_chosen(const Scene& scene, const CellType& cell) {
  const double period_s = cell.calcium_factor_period_s;
  if (period_s == 0 || std::abs(period_s - scene.period_s) < 1e-9 || !cell.from_limit_cycle) return 0;
  PacedCell there = make_paced_cell(scene, cell, period_s);
  std::vector<double> state = cell.ionic->default_state();
  LimitCycleSettings settings;
  settings.attractor = Attractor::paced;
  settings.distance = 1e-3;  // a warning's worth
  if (!there.to_limit_cycle(state, settings).good()) return 0;
  double low = std::numeric_limits<double>::infinity(), high = 0;
  there.beat(state, 1.0, [&](double, const double* y, double) {
    const double calcium = y[cell.ionic->cytosolic_calcium] * units::uM_per_mM;
    low = std::min(low, calcium);
    high = std::max(high, calcium);
  });
  CalciumRescaling rescaling = cell.rescaling;
  rescaling.diastolic_uM = low;
  return rescaling(high);
}

}  // namespace

void require_one_beat_cycle(const LimitCycleCertificate& certificate, const std::string& name,
                            const CellModel& model, double period_s) {
  if (certificate.good()) return;
  throw NumericalFailure(fmt::format(
      "cells {}: {} at {:g} ms: {} Use another period, other parameters, or start = \"published\" with "
      "run.beats = N to see the beats as they come.",
      name, model.name, period_s * 1e3, limit_cycle_failure(certificate)));
}

std::map<std::string, PacedCellType> pace_cells(const Scene& scene, Progress::Style style) {
  std::map<std::string, PacedCellType> all;
  for (const auto& [name, cell] : scene.cells) {
    PacedCellType paced;
    if (cell.ionic) {
      PacedCell one = make_paced_cell(scene, cell, scene.period_s);
      paced.state_at_onset = cell.ionic->default_state();
      if (cell.from_limit_cycle) {
        Progress progress(fmt::format("cells {} ({})", name, cell.ionic->name), style);
        LimitCycleSettings settings;
        settings.attractor = Attractor::paced;
        paced.certificate =
            one.to_limit_cycle(paced.state_at_onset, settings, [&](const LimitCycleCertificate& c) {
              progress.update(-1, fmt::format("beat {}, distance {:.1e}", c.beats, c.distance));
            });
        require_one_beat_cycle(paced.certificate, name, *cell.ionic, scene.period_s);
        progress.finish(fmt::format("on the limit cycle after {} beats, distance {:.1e}",
                                    paced.certificate.beats, paced.certificate.distance));
        paced.charge_drift_mV = one.charge_drift();
      }
      double low = std::numeric_limits<double>::infinity(), high = 0, peak = -1000;
      const CellModel& ionic = *cell.ionic;
      std::vector<double> state = paced.state_at_onset;
      one.beat(state, 1.0, [&](double, const double* y, double) {
        peak = std::max(peak, y[ionic.membrane_potential]);
        if (!ionic.has_calcium()) return;
        const double calcium = y[ionic.cytosolic_calcium] * units::uM_per_mM;
        low = std::min(low, calcium);
        high = std::max(high, calcium);
      });
      paced.potential_max_mV = peak;
      if (!ionic.has_calcium()) {  // it drives no force
        all.emplace(name, std::move(paced));
        continue;
      }
      CalciumRescaling rescaling = cell.rescaling;
      rescaling.diastolic_uM = low;
      paced.calcium_min_uM = rescaling(low);
      paced.calcium_max_uM = rescaling(high);
      paced.calcium_max_where_chosen_uM = calcium_where_chosen(scene, cell);
    } else {
      paced.calcium_min_uM = cell.transient.rest_uM;
      paced.calcium_max_uM = cell.transient.peak_uM;
    }
    all.emplace(name, std::move(paced));
  }
  return all;
}

}  // namespace wiggers
