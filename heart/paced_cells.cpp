#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <wiggers/cellmodels/pacing.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/paced_cells.hpp>

namespace wiggers {

namespace {

PacedCell make_paced_cell(const Scene& scene, const CellType& cell) {
  return PacedCell(*cell.ionic, cell.ionic_parameters, {scene.period_s * units::ms_per_s, cell.stimulus},
                   {scene.electrophysiology_integrator, 1e-8, 1e-10, scene.electrophysiology_substep_ms});
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
      PacedCell one = make_paced_cell(scene, cell);
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
    all.emplace(name, std::move(paced));
  }
  return all;
}

}  // namespace wiggers
