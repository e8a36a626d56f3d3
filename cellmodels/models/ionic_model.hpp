// How to add an ionic model: one header here, and one line in ionic_models.hpp.
//
//  1. Write a struct with name (how users call it), title, source (the paper), time_unit = "ms" and
//     default_stimulus.
//  2. List states, parameters, inputs = {facts::stimulus} and observables as std::arrays of Quantity, each
//     with static_assert(well_formed(...)), and an enum for each but the observables with
//     static_assert(named_as<...>). Mark what a state is where it stands: facts::membrane_potential,
//     facts::gate, facts::voltage_gate, marked(Role::calcium, ...) if the cell has calcium that drives a
//     force model, marked(Role::stimulus_ion, ...) for the ion that carries the stimulus. The potential may
//     stand anywhere. Ranges are wide: facts::positive and facts::non_negative; a parameter bounded by
//     sense is named in tests/models/right_hand_sides.cpp.
//  3. List parameter_sets, the first one "default".
//  4. Derive Constants<P> from the parameters in constants<P>(): plain numbers of P and nothing else.
//  5. Write evaluate<N, P>(y, inputs, constants): for a gate its steady value and time constant, for any
//     other state its derivative, and the observables. Use select(mask, a, b) for branches and the
//     library's x_over_expm1 and the like for removable singularities; N is a double, a SIMD vector or a
//     dual number.
//  6. List invariants with invariant_values and invariant_slopes (crn.hpp shows a charge); or say in
//     no_invariants why there are none. A parameter that is the share of the stimulus an ion carries is
//     facts::stimulus_K_fraction: where it is not 1 the charge is not kept.
//  7. If you like: split evaluate in voltage_gates, voltage_factors (n_voltage_factors of them) and
//     balances, so that tables can stand in for what depends on the potential alone (only then are there
//     voltage gates); list branch_potentials where rates jump, ascending, hold them as P branch[...] in
//     Constants and ask V < branch[k] (ttp06.hpp); name as SameEquations a model that differs by numbers
//     alone, whose compiled kernels this one may share.
//
// The rest follows: command, all integrators, SIMD kernels, limit cycles, sensitivities, tissue, Python, and
// the tests that loop over all models. `make reference` writes the model's page. aliev_panfilov.hpp is the
// smallest complete one.
#pragma once

#include <algorithm>
#include <concepts>
#include <string_view>
#include <type_traits>
#include <wiggers/cellmodels/models/invariant.hpp>
#include <wiggers/cellmodels/models/stimulus.hpp>
#include <wiggers/core/evaluation.hpp>

namespace wiggers {

template <class Model>
concept NamedModel = requires {
  { Model::name } -> std::convertible_to<std::string_view>;
  { Model::title } -> std::convertible_to<std::string_view>;
  { Model::source } -> std::convertible_to<std::string_view>;
  { Model::time_unit } -> std::convertible_to<std::string_view>;
};
template <class Model>
concept HasFactSheets = requires {
  Model::states.size();
  Model::parameters.size();
  Model::inputs.size();
  Model::observables.size();
  Model::parameter_sets.size();
};
template <class Model>
concept HasConstants = requires(const double* parameters) {
  { Model::constants(parameters) } -> std::same_as<typename Model::template Constants<double>>;
  requires std::is_trivially_copyable_v<typename Model::template Constants<double>>;
  // All of them are P: kernels fill SIMD vectors number by number.
  requires sizeof(typename Model::template Constants<double>) ==
      2 * sizeof(typename Model::template Constants<float>);
};
template <class Model>
concept CanEvaluate = requires(const double* y, const typename Model::template Constants<double>& constants) {
  { Model::template evaluate<double>(y, y, constants) } -> std::same_as<EvaluationOf<Model, double>>;
};
template <class Model>
concept HasInvariants = requires(const double* y,
                                 const typename Model::template Constants<double>& constants) {
  requires Model::invariants.size() > 0;
  Model::invariant_values(y, constants)[Model::invariants.size() - 1];
  Model::invariant_slopes(constants)[Model::invariants.size() - 1];
};
template <class Model>
concept SaysWhyNoInvariants = requires {
  requires !std::string_view(Model::no_invariants).empty();
};

template <class Model>
concept HoldsBranches = requires(typename Model::template Constants<double>& constants) {
  requires std::extent_v<decltype(constants.branch)>
  == Model::branch_potentials.size();
};

template <class Model>
concept IonicModel = NamedModel<Model> && HasFactSheets<Model> && HasConstants<Model> && CanEvaluate<Model> &&
                     (HasInvariants<Model> || SaysWhyNoInvariants<Model>)&&potential_of<Model> >= 0;

// What a model forgot, each in a sentence.
template <class Model>
consteval bool require_ionic_model() {
  static_assert(NamedModel<Model>, "an ionic model has a name, a title, a source and a time_unit");
  static_assert(HasFactSheets<Model>,
                "an ionic model lists states, parameters, inputs, observables and parameter_sets");
  static_assert(Model::time_unit == std::string_view("ms"), "an ionic model's time_unit is \"ms\"");
  static_assert(std::same_as<std::remove_cvref_t<decltype(Model::default_stimulus)>, StimulusPulse>,
                "an ionic model has a default_stimulus");
  static_assert(Model::inputs.size() == 1 && Model::inputs[0].role == Role::stimulus,
                "an ionic model's inputs are {facts::stimulus}");
  static_assert(potential_of<Model> >= 0,
                "one state of an ionic model is marked as the potential: facts::membrane_potential");
  static_assert(Model::parameter_sets[0].name == "default", "the first parameter set is named \"default\"");
  static_assert(HasConstants<Model>,
                "an ionic model derives Constants<P>, plain numbers of P alone, in constants(parameters)");
  static_assert(CanEvaluate<Model>, "an ionic model evaluates: evaluate<N>(y, inputs, constants)");
  static_assert(HasInvariants<Model> || SaysWhyNoInvariants<Model>,
                "an ionic model lists invariants with invariant_values and invariant_slopes, or says "
                "in no_invariants why it has none");
  static_assert(
      InParts<Model> || std::ranges::none_of(is_voltage_gate<Model>, [](bool is) { return is; }),
      "voltage gates need voltage_gates, voltage_factors and balances; mark other gates as facts::gate");
  if constexpr (requires { Model::branch_potentials; }) {
    static_assert(std::ranges::is_sorted(Model::branch_potentials), "branch_potentials ascend");
    static_assert(HoldsBranches<Model>, "branch_potentials stand as P branch[...] in Constants<P>");
  }
  if constexpr (calcium_of<Model> >= 0)
    static_assert(Model::states[calcium_of<Model>].unit == std::string_view("mM"),
                  "calcium that drives a force model is in mM: facts::free_calcium");
  return IonicModel<Model>;
}

// The model whose compiled kernels serve this one.
template <class Model>
struct SameEquationsOf {
  using type = Model;
};
template <class Model>
requires requires { typename Model::SameEquations; }
struct SameEquationsOf<Model> {
  using type = typename Model::SameEquations;
};

template <class... Models>
struct IonicModelList {
  static_assert((require_ionic_model<Models>() && ...));
  // visit<Model>() for each.
  template <class Visit>
  static constexpr void each(Visit visit) {
    (visit.template operator()<Models>(), ...);
  }
};

}  // namespace wiggers
