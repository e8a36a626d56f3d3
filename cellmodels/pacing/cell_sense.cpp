#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/models/facts.hpp>
#include <wiggers/cellmodels/pacing/cell_sense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>

namespace wiggers {

namespace {
constexpr double saved_invariant_tolerance = 1e-6;

std::string sentence(const Quantity& q, double value, const std::string& when) {
  return fmt::format(
      "unphysical: the {} is {:.4g} {} {}; no living cell is outside {:g} to {:g} {}. Look at the pumps, "
      "exchangers and leaks that hold it, and at the stimulus.",
      q.meaning, value, q.unit, when, q.lower, q.upper, q.unit);
}
}  // namespace

CellSense::CellSense(const CellModel& model) : model_(model) {
  for (std::size_t i = 0; i < model.states.size(); ++i) {
    const auto found = std::find_if(facts::living.begin(), facts::living.end(), [&](const Quantity& q) {
      return q.role == Role::none ? q.name == model.states[i].name : q.role == model.states[i].role;
    });
    if (found == facts::living.end()) continue;
    watched_.push_back({static_cast<int>(i), *found,
                        found->unit == "uM" && model.states[i].unit == "mM" ? units::uM_per_mM : 1});
  }
}

void CellSense::see(double t_ms, const double* y) {
  rows_end_ms_ = t_ms;
  if (model_.has_calcium())
    calcium_low_ = std::min(calcium_low_, units::uM_per_mM * y[model_.cytosolic_calcium]);
  // The quantity that left its bounds first, where it is farthest outside.
  for (const Watched& w : watched_) {
    if (found_ >= 0 && found_ != w.state) continue;
    const double value = w.factor * y[w.state];
    const double excess = std::max(w.bounds.lower - value, value - w.bounds.upper);
    if (!(excess > excess_)) continue;
    found_ = w.state;
    excess_ = excess;
    finding_ = sentence(w.bounds, value, fmt::format("at t = {:.4g} ms of the beat", t_ms));
  }
}

std::string CellSense::finding() const {
  const Quantity& q = facts::living_diastolic_calcium;
  if (finding_.empty() && model_.has_calcium() && rows_end_ms_ > 0 && calcium_low_ > q.upper)
    return sentence(q, calcium_low_, "all through the beat");
  return finding_;
}

void require_invariants(const CellModel& model, const std::vector<double>& found,
                        const std::vector<double>& wanted, bool charge_too, const std::string& place) {
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    const Invariant& invariant = model.invariants[k];
    if (invariant.is_charge && !charge_too) continue;
    if (!(std::abs(found[k] - wanted[k]) <= saved_invariant_tolerance * std::max(1.0, std::abs(wanted[k]))))
      throw InputError(fmt::format("{}: its conserved {} is {:.9g} {}, that of these cells is {:.9g} {}",
                                   place, invariant.name, found[k], invariant.unit, wanted[k],
                                   invariant.unit));
  }
}

void require_saved_state(const CellModel& model, const std::vector<double>& parameters,
                         double charge_offset_mV, const std::vector<double>& state,
                         const std::string& place) {
  for (std::size_t i = 0; i < state.size(); ++i) {
    Quantity wide = model.states[i];
    const double slack = 1e-3 * (std::isfinite(wide.upper) ? std::max(1.0, std::abs(wide.upper)) : 1.0);
    wide.lower -= slack;
    wide.upper += slack;
    check_range(wide, state[i], place);
  }
  if (!model.keeps_invariants(parameters.data())) return;
  std::vector<double> wanted = model.invariant_values(model.default_state().data(), parameters.data());
  if (const int charge = model.charge_invariant(); charge >= 0)
    wanted[static_cast<std::size_t>(charge)] += charge_offset_mV;
  require_invariants(model, model.invariant_values(state.data(), parameters.data()), wanted, true, place);
}

void judge_cell(LimitCycleCertificate& certificate, const std::string& finding) {
  if (finding.empty() || !certificate.is_cycle()) return;
  certificate.verdict = LimitCycleVerdict::unphysical;
  certificate.reason = finding;
}

}  // namespace wiggers
