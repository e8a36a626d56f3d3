#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/heart/walls/active_fibre.hpp>

namespace wiggers {

template <class T>
ActiveFibreOf<T>::ActiveFibreOf(ActiveFibreSettings settings, const CellModel& force,
                                const std::vector<T>& force_parameters, const T& rest_calcium_uM,
                                std::unique_ptr<CellSourceOf<T>> cell, std::string place)
    : settings_(settings),
      model_(force),
      force_(make_force_stepper<T>(force, force_parameters)),
      cell_(std::move(cell)),
      place_(std::move(place)),
      rest_(steady_force_state(force, force_parameters, rest_calcium_uM, force_->reference_length_um())),
      bridges_(rest_) {}

template <class T>
void ActiveFibreOf<T>::start(const T& stretch) {
  stretch_ = stretch_before_ = stretch;
  forces_ = {};
}

template <class T>
void ActiveFibreOf<T>::begin_step(const T& t, const T& dt) {
  dt_ = dt;
  cell_->advance(t, dt);
  forces_ = {};
  if (!settings_.active) return;
  const T length = force_->reference_length_um() * stretch_;
  if (!force_->holds_at(length))
    throw NumericalFailure(fmt::format(
        "{}: a sarcomere length of {:.4g} um is beyond what {} describes: {}. Check this wall's volumes, "
        "its stiffness and the force model's parameters.",
        place_, value_of(length), model_.name, force_->beyond(value_of(length))));
  const T calcium = cell_->calcium_uM();
  const bool midpoint = settings_.scheme.regulation == RegulationScheme::midpoint;
  const T driving = !midpoint || calcium_before_ < 0.0 ? calcium : T(0.5 * (calcium_before_ + calcium));
  calcium_before_ = calcium;
  const T velocity_before = -(stretch_ - stretch_before_) / (dt_before_ > 0.0 ? dt_before_ : dt);
  const char* remedy = midpoint
                           ? "a smaller dt_s"
                           : "a smaller regulatory_substep_us, or solver.regulation = \"frozen-midpoint\"";
  if (!force_->begin(settings_.scheme, dt, bridges_.data(), driving, length, velocity_before, forces_))
    throw NumericalFailure(fmt::format("{}: rates of {} at calcium {} uM are beyond a step of {} s; try {}.",
                                       place_, model_.name, value_of(driving), value_of(dt), remedy));
  for (std::size_t i = 0; i < bridges_.size(); ++i)
    if (const Quantity& q = model_.states[i]; !(bridges_[i] > q.lower - 1e-6 && bridges_[i] < q.upper + 1e-6))
      throw NumericalFailure(fmt::format("{}: state {} = {} of {} left [{}, {}]; try {}.", place_, q.name,
                                         value_of(bridges_[i]), model_.name, q.lower, q.upper, remedy));
  if (settings_.subtract_rest_tension) {
    const T above = forces_.tension_kPa - force_->forces(rest_.data(), length).tension_kPa;
    forces_.tension_kPa = select(above > 0.0, above, T(0.0));
  }
  if (!settings_.stabilise) forces_.stiffness_kPa = 0;
}

template <class T>
void ActiveFibreOf<T>::accept_step(const T& stretch) {
  if (settings_.active) {
    if (settings_.scheme.rate == RateScheme::implicit &&
        !force_->finish(dt_, bridges_.data(), T(-(stretch - stretch_) / dt_)))
      throw NumericalFailure(
          fmt::format("{}: {} cannot follow a stretch from {:.4g} to {:.4g} in one step; try a smaller dt_s.",
                      place_, model_.name, value_of(stretch_), value_of(stretch)));
    forces_.tension_kPa += forces_.stiffness_kPa * (stretch - stretch_);
  }
  forces_.stiffness_kPa = 0;
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
  out.insert(out.end(), {stretch_, stretch_before_, forces_.tension_kPa, calcium_before_});
  out.insert(out.end(), bridges_.begin(), bridges_.end());
  cell_->save(out);
}

template <class T>
void ActiveFibreOf<T>::restore(std::span<const T>& in) {
  stretch_ = take_saved(in);
  stretch_before_ = take_saved(in);
  forces_ = {take_saved(in), 0};
  calcium_before_ = take_saved(in);
  dt_before_ = -1;
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
  values[1] = value_of(forces_.tension_kPa);
  values[2] = value_of(stretch_);
  if (cell_->has_potential()) values[3] = cell_->potential_mV();
}

template class ActiveFibreOf<double>;
template class ActiveFibreOf<Tangent>;

}  // namespace wiggers
