// How to add a force model: one header here, and one line in force_models.hpp.
//
//  1. Write a struct with name, title, source (the paper) and time_unit = "s".
//  2. List states, parameters, observables and inputs = facts::force_inputs with an enum for each and
//     static_assert of well_formed and named_as. Mark in the parameters facts::reference_length and one
//     Role::strength (it scales the tension and nothing else: a wall's own key); the observables hold
//     facts::active_tension and facts::active_stiffness.
//  3. List parameter_sets, the first one with no changes; derive Constants<P> in constants(): numbers of P
//     alone, among them the parameters as P p[...]; write evaluate().
//  4. Split the step of a wall in two. regulate(h, y, calcium, length, constants, regulation) moves the
//     first n_regulated states and says in Regulation<N> what they mean for the bridges; regulation(y, ...)
//     says it at a state, with the derivatives of these states in its std::array derivative. cycle(h, y,
//     regulation, v, v_detaching, constants) moves the others for a shortening velocity v = -(dSL/dt)/SL0;
//     what decides how many bridges there are takes v_detaching, so that the tension is linear in v. Both
//     give false where they cannot.
//  5. Write tension(y, length, constants) and stiffness(...) in kPa, holds_at(length, parameters) and
//     beyond(length, parameters), which says why not.
//  6. Invariants, or no_invariants with the reason, as for an ionic model. spread(y), if there is one, is
//     where the search for a steady state starts; normalise(y) takes out what schemes let drift.
//
// The rest follows: command, SIMD kernels, every form of stretch rate, reduced walls, TriSeg, tissue,
// sensitivities, the monolithic heart, Python, and the tests that loop over all models. `make reference`
// writes the model's page.
#pragma once

#include <string>
#include <tuple>
#include <type_traits>
#include <wiggers/cellmodels/models/ionic_model.hpp>

namespace wiggers {

template <class Model>
concept KeepsParameters = requires(const typename Model::template Constants<double>& constants) {
  requires std::extent_v<decltype(constants.p)>
  == Model::parameters.size();
};
template <class Model>
concept StepsInWalls = requires(const double h, double* y, const double x,
                                const typename Model::template Constants<double>& c,
                                typename Model::template Regulation<double>& regulation) {
  { Model::regulate(h, y, x, x, c, regulation) } -> std::same_as<bool>;
  { Model::cycle(h, y, regulation, x, x, c) } -> std::same_as<bool>;
  { Model::regulation(y, x, x, c) } -> std::same_as<typename Model::template Regulation<double>>;
  requires std::tuple_size_v<decltype(regulation.derivative)>
  == Model::n_regulated;
  requires Model::n_regulated >
  0 && Model::n_regulated <= static_cast<int>(Model::states.size());
};
template <class Model>
concept GivesForce = requires(const double* y, const double x,
                              const typename Model::template Constants<double>& c) {
  { Model::tension(y, x, c) } -> std::same_as<double>;
  { Model::stiffness(y, x, c) } -> std::same_as<double>;
  { Model::holds_at(x, y) } -> std::same_as<bool>;
  { Model::beyond(x, y) } -> std::convertible_to<std::string>;
};

template <class Model>
concept ForceModel = NamedModel<Model> && HasFactSheets<Model> && HasConstants<Model> && CanEvaluate<Model> &&
    StepsInWalls<Model> && GivesForce<Model>;

// What a model forgot, each in a sentence.
template <class Model>
consteval bool require_force_model() {
  static_assert(NamedModel<Model>, "a force model has a name, a title, a source and a time_unit");
  static_assert(HasFactSheets<Model>,
                "a force model lists states, parameters, inputs, observables and parameter_sets");
  static_assert(Model::time_unit == std::string_view("s"), "a force model's time_unit is \"s\"");
  static_assert(Model::inputs.size() == 3 && Model::inputs[2].name == std::string_view("dSL/dt"),
                "a force model's inputs are facts::force_inputs");
  static_assert(index_of(Model::parameters, Role::strength) >= 0,
                "one parameter of a force model is its strength");
  static_assert(index_of(Model::parameters, Role::reference_length) >= 0,
                "one parameter of a force model is facts::reference_length");
  static_assert(
      index_of(Model::observables, Role::tension) >= 0 && index_of(Model::observables, Role::stiffness) >= 0,
      "a force model observes facts::active_tension and facts::active_stiffness");
  static_assert(HasConstants<Model>,
                "a force model derives Constants<P>, plain numbers of P alone, in constants(parameters)");
  static_assert(KeepsParameters<Model>, "a force model's Constants<P> hold its parameters as P p[...]");
  static_assert(CanEvaluate<Model>, "a force model evaluates: evaluate<N>(y, inputs, constants)");
  static_assert(
      StepsInWalls<Model>,
      "a force model steps by regulation, regulate and cycle of its Regulation<N>, whose derivative is a "
      "std::array of n_regulated");
  static_assert(GivesForce<Model>, "a force model gives tension and stiffness, holds_at and beyond");
  static_assert(HasInvariants<Model> || SaysWhyNoInvariants<Model>,
                "a force model lists invariants with invariant_values and invariant_slopes, or says in "
                "no_invariants why it has none");
  return ForceModel<Model>;
}

template <class... Models>
struct ForceModelList {
  static_assert((require_force_model<Models>() && ...));
  // visit<Model>() for each.
  template <class Visit>
  static constexpr void each(Visit visit) {
    (visit.template operator()<Models>(), ...);
  }
};

}  // namespace wiggers
