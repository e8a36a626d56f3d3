#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/schemes/rdq20_midpoint.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/walls/active_fibre.hpp>

namespace wiggers {

template <class T>
ActiveFibreOf<T>::ActiveFibreOf(ActiveFibreSettings settings, const std::vector<T>& force_parameters,
                                const T& rest_calcium_uM, std::unique_ptr<CellSourceOf<T>> cell,
                                std::string place)
    : settings_(settings), force_(force_parameters), cell_(std::move(cell)), place_(std::move(place)) {
  const T SL0 = force_.constants().p[Rdq20::SL0];
  const std::vector<T> rest = rdq20_steady_state(force_parameters, rest_calcium_uM, SL0);
  std::copy(rest.begin(), rest.end(), bridges_.begin());
  mu1_rest_ = rest[Rdq20::mu1_P] + rest[Rdq20::mu1_N];
  if (settings_.regulation == RegulationScheme::midpoint && !std::is_same_v<T, double>)
    throw InputError("sensitivities of a heart need solver.regulation = \"forward-euler\"");
}

template <class T>
void ActiveFibreOf<T>::start(const T& stretch) {
  stretch_ = stretch_before_ = stretch;
  tension_ = stiffness_ = 0;
}

template <class T>
void ActiveFibreOf<T>::begin_step(const T& t, const T& dt) {
  dt_ = dt;
  cell_->advance(t, dt);
  tension_ = stiffness_ = 0;
  if (!settings_.active) return;
  const auto& p = force_.constants().p;
  const T SL = p[Rdq20::SL0] * stretch_;
  if (!(Rdq20::dissociation_constant(SL, p) > 0.0))
    throw NumericalFailure(fmt::format(
        "{}: sarcomere length {:.4g} um makes the calcium dissociation constant of RDQ20 negative: the "
        "wall is stretched beyond the force model. Check volumes and stiffness of this wall.",
        place_, value_of(SL)));
  const T calcium = cell_->calcium_uM();
  if (settings_.regulation == RegulationScheme::midpoint) {
    if constexpr (std::is_same_v<T, double>) {
      const double middle = calcium_before_ < 0 ? calcium : 0.5 * (calcium_before_ + calcium);
      if (!Rdq20Midpoint<double>().step_regulation(dt, bridges_.data(), middle, SL, force_.constants(),
                                                   regulation_))
        throw NumericalFailure(
            fmt::format("{}: rates of RDQ20 at calcium {} uM are beyond a step of {} s; try a smaller "
                        "dt_s.",
                        place_, middle, dt));
    }
  } else {
    regulation_ = force_.step_regulation(bridges_.data(), calcium, SL, dt, settings_.regulatory_substeps);
  }
  calcium_before_ = calcium;
  // The scheme keeps the sum of the probabilities but for rounding; held, a perturbed sum is no neutral
  // direction of the beat map.
  T sum = bridges_[0];
  for (int i = 1; i < Rdq20::n_probabilities; ++i) sum += bridges_[i];
  const T normalise = 1.0 / sum;
  for (int i = 0; i < Rdq20::n_probabilities; ++i) bridges_[i] = bridges_[i] * normalise;
  for (int i = 0; i < Rdq20::n_probabilities; ++i)
    if (!(bridges_[i] > -1e-6 && bridges_[i] < 1 + 1e-6))
      throw NumericalFailure(
          fmt::format("{}: probability {} = {} of RDQ20 left [0, 1]; try a smaller {}.", place_,
                      Rdq20::states[i].name, value_of(bridges_[i]),
                      settings_.regulation == RegulationScheme::midpoint ? "dt_s" : "regulatory_substep_us"));
  const T v_before =
      -(stretch_ - stretch_before_) / (dt_before_ > 0.0 ? dt_before_ : dt);  // shortening positive
  std::copy(bridges_.begin() + 16, bridges_.end(), moments_before_.begin());
  force_.step_crossbridges(bridges_.data(), regulation_,
                           settings_.rate == RateScheme::lagged ? v_before : T(0.0), dt);
  const T scale = force_.scale(SL);
  if (settings_.rate == RateScheme::implicit) {
    // Predicted without sliding but with the detachment rate of the last velocity.
    const T r = p[Rdq20::r0] + p[Rdq20::alpha] * abs(v_before);
    const T S0_start = moments_before_[0] + moments_before_[2];
    const T S1_inf = p[Rdq20::mu1_fP] * regulation_.permissivity / r;
    const T S0_inf = p[Rdq20::mu0_fP] * regulation_.permissivity / r;
    const T decay = exp(T(-r * dt));
    const T S1 = S1_inf + (moments_before_[1] + moments_before_[3] - S1_inf) * decay;
    const T S0_mean = S0_inf * (-expm1(T(-r * dt))) / (r * dt) + (S0_start - S0_inf) * decay;
    tension_ = scale * S1;
    stiffness_ = scale * S0_mean;
  } else {
    tension_ = force_.tension_kPa(bridges_.data(), SL);
    stiffness_ = settings_.rate == RateScheme::none ? T(0.0) : force_.stiffness_kPa(bridges_.data(), SL);
  }
  if (settings_.subtract_rest_tension) {
    const T above = tension_ - scale * mu1_rest_;
    tension_ = select(above > 0.0, above, T(0.0));
  }
  if (!settings_.stabilise) stiffness_ = 0;
}

template <class T>
void ActiveFibreOf<T>::accept_step(const T& stretch) {
  if (settings_.active) {
    if (settings_.rate == RateScheme::implicit) {
      std::copy(moments_before_.begin(), moments_before_.end(), bridges_.begin() + 16);
      force_.step_crossbridges(bridges_.data(), regulation_, T(-(stretch - stretch_) / dt_), dt_);
    }
    tension_ += stiffness_ * (stretch - stretch_);
  }
  stiffness_ = 0;
  stretch_before_ = stretch_;
  stretch_ = stretch;
  dt_before_ = dt_;
}

template <class T>
void ActiveFibreOf<T>::move_to(const T& stretch) {
  stretch_before_ += stretch - stretch_;
  stretch_ = stretch;
}

template <class T>
void ActiveFibreOf<T>::save(std::vector<T>& out) const {
  out.insert(out.end(), {stretch_, stretch_before_, tension_, calcium_before_});
  out.insert(out.end(), bridges_.begin(), bridges_.end());
  cell_->save(out);
}

template <class T>
void ActiveFibreOf<T>::restore(std::span<const T>& in) {
  stretch_ = take_saved(in);
  stretch_before_ = take_saved(in);
  tension_ = take_saved(in);
  calcium_before_ = take_saved(in);
  dt_before_ = -1;
  stiffness_ = 0;
  for (T& value : bridges_) value = take_saved(in);
  cell_->restore(in);
}

template <class T>
std::vector<WallOutput> ActiveFibreOf<T>::outputs() const {
  std::vector<WallOutput> list = {
      {"calcium", "uM", "calcium that the force model sees"},
      {"active_tension", "kPa", "active tension, rest tension removed, stabilising term included"},
      {"stretch", "1", "fibre stretch", smallest_stretch, largest_stretch}};
  if (cell_->has_potential()) list.push_back({"membrane_potential", "mV", "membrane potential"});
  return list;
}

template <class T>
void ActiveFibreOf<T>::output_values(double* values) const {
  values[0] = value_of(cell_->calcium_uM());
  values[1] = value_of(tension_);
  values[2] = value_of(stretch_);
  if (cell_->has_potential()) values[3] = cell_->potential_mV();
}

template class ActiveFibreOf<double>;
template class ActiveFibreOf<Tangent>;

}  // namespace wiggers
