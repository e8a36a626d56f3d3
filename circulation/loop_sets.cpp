// Parameter sets of the circulation, each with its source.
#include <algorithm>
#include <array>
#include <wiggers/circulation/loop.hpp>
#include <wiggers/core/errors.hpp>

namespace wiggers {

namespace {

// R, C, L of AR_SYS, VEN_SYS, AR_PUL, VEN_PUL; all of them.
using Vessels = std::array<VesselParameters, n_vessels>;
template <std::size_t n>
Vessels all(const VesselParameters (&vessels)[n]) {
  static_assert(n == n_vessels, "a set has numbers for every vessel");
  return std::to_array(vessels);
}

// Volumes of the chambers, pressures of the vessels, flows out of them.
template <std::size_t c, std::size_t v, std::size_t f>
CirculationValues start(const double (&volumes)[c], const double (&pressures)[v], const double (&flows)[f]) {
  static_assert(c == n_chambers && v == n_vessels && f == n_vessels, "a set starts every chamber and vessel");
  CirculationValues y{};
  std::copy(volumes, volumes + c, y.begin());
  std::copy(pressures, pressures + v, y.begin() + n_chambers);
  std::copy(flows, flows + f, y.begin() + n_nodes);
  return y;
}

Loop make(double period, ValveLaw law, double Rmax, const Vessels& vessels,
          std::array<ElastanceParameters, 4> elastance, CirculationValues initial) {
  Loop loop;
  loop.period_s = period;
  loop.circulation.valve_law = law;
  for (ValveParameters& valve : loop.circulation.valves) valve = {0.0075, Rmax};
  loop.circulation.vessels = vessels;
  loop.elastance = elastance;
  loop.initial = initial;
  return loop;
}

// The fact sheet of the elastance has the left ventricle's values as defaults.
ElastanceParameters default_left_ventricle() {
  const auto v = defaults_of(elastance_quantities);
  return {v[0], v[1], v[2], v[3], v[4], v[5]};
}

const Vessels fedele_vessels =
    all({{0.48, 1.5, 5e-3}, {0.26, 60, 5e-4}, {0.032116, 10, 5e-4}, {0.035684, 16, 5e-4}});

std::vector<CirculationSet> make_sets() {
  std::vector<CirculationSet> sets;
  sets.push_back(
      {"wiggers-healthy-0d",
       "tuned for this project (not published values): a physiological limit cycle with elastance chambers "
       "at 75 "
       "beats per minute",
       make(0.8, law_of<DiodeValve>, 75000,
            all({{0.72, 1.3, 5e-3}, {0.26, 60, 5e-4}, {0.04, 6, 5e-4}, {0.03, 16, 5e-4}}),
            {ElastanceParameters{0.10, 0.09, 0.66, 0.136, 0.136, 4}, default_left_ventricle(),
             ElastanceParameters{0.06, 0.07, 0.66, 0.136, 0.136, 4},
             ElastanceParameters{0.55, 0.05, 0, 0.272, 0.136, 10}},
            defaults_of(circulation_state_quantities)),
       true});
  sets.push_back(
      {"fedele2023",
       "Fedele et al. 2023 (whole-heart paper), table of circulation parameters; valves and vessels only, "
       "diode law with the printed branches corrected",
       make(0.8, law_of<DiodeValve>, 75000, fedele_vessels, {},
            start({60, 130, 70, 140}, {75, 32, 20, 14}, {0, 0, 0, 0})),
       false});
  sets.push_back({"baseline75", "authors' 0D script of Regazzoni et al. 2022, 75 beats per minute",
                  make(0.8, law_of<LogArctanValve>, 75006.2,
                       all({{0.84, 1.2, 5e-3}, {0.32, 60, 5e-4}, {0.032, 10, 5e-4}, {0.035, 16, 5e-4}}),
                       {ElastanceParameters{0.07, 0.18, 0.72, 0.136, 0.136, 4},
                        ElastanceParameters{3.35, 0.20, 0.08, 0.2, 0.32, 42},
                        ElastanceParameters{0.06, 0.07, 0.72, 0.136, 0.136, 4},
                        ElastanceParameters{0.55, 0.05, 0.08, 0.2, 0.32, 16}},
                       start({80, 110, 80, 110}, {70, 40, 25, 20}, {0, 0, 0, 0})),
                  true});
  const double beat72 = 60.0 / 72;
  const auto fractions = [&](double EA, double EB, double tC, double TC, double TR, double V0) {
    return ElastanceParameters{EA, EB, tC * beat72, TC * beat72, TR * beat72, V0};
  };
  sets.push_back({"regazzoni2022-script",
                  "class default of the authors' 0D script of Regazzoni et al. 2022, 72 beats "
                  "per minute",
                  make(beat72, law_of<LogArctanValve>, 75006.2,
                       all({{0.8, 1.2, 5e-3}, {0.26, 60, 5e-4}, {0.1625, 10, 5e-4}, {0.1625, 16, 5e-4}}),
                       {fractions(0.07, 0.09, 0.80, 0.17, 0.17, 4), fractions(2.75, 0.08, 0, 0.34, 0.17, 5),
                        fractions(0.06, 0.07, 0.80, 0.17, 0.17, 4), fractions(0.55, 0.05, 0, 0.34, 0.17, 10)},
                       start({65, 120, 65, 145}, {80, 30, 35, 24}, {0, 0, 0, 0})),
                  true});
  sets.push_back(
      {"circulation-0.3.1",
       "defaults of the Python package circulation 0.3.1 (atria and ventricles contract "
       "together: a numerical reference, not physiology)",
       make(0.8, law_of<LogArctanValve>, 75006.2,
            all({{0.733, 1.372, 5e-3}, {0.32, 11.363, 5e-4}, {0.046, 20, 5e-4}, {0.0015, 16, 5e-4}}),
            {ElastanceParameters{0.07, 0.18, 0.9, 0.17, 0.17, 4},
             ElastanceParameters{4.482, 0.17, 0.1, 0.25, 0.4, 42},
             ElastanceParameters{0.06, 0.07, 0.9, 0.17, 0.17, 4},
             ElastanceParameters{0.20, 0.029, 0.1, 0.25, 0.4, 16}},
            start({87.183, 118.520, 86.833, 166.177}, {87.675, 35.898, 19.545, 15.004},
                  {71.104, 94.039, 94.084, 473.279})),
       true});
  return sets;
}

}  // namespace

std::span<const CirculationSet> circulation_sets() {
  static const std::vector<CirculationSet> sets = make_sets();
  return sets;
}

std::vector<std::string> circulation_set_names(bool with_elastances) {
  std::vector<std::string> names;
  for (const CirculationSet& set : circulation_sets())
    if (set.has_elastances || !with_elastances) names.emplace_back(set.name);
  return names;
}

const CirculationSet& find_circulation_set(std::string_view name) {
  for (const CirculationSet& set : circulation_sets())
    if (set.name == name) return set;
  refuse_unknown("circulation parameter set", name, circulation_set_names(false));
}

}  // namespace wiggers
