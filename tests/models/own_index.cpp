// An index that was added by its recipe alone (own_index.cmake): by its name, with its derivative.
#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <string>
#include <wiggers/core/dual.hpp>
#include <wiggers/heart/indexes/indexes_of.hpp>

using namespace wiggers;

namespace {
// A beat of straight lines and half sines; the pressure of the left ventricle is `scale` times a half sine.
template <class T>
BeatTraceOf<T> beat(const T& scale) {
  BeatTraceOf<T> trace;
  for (int k = 0; k <= 800; ++k) {
    const double t = 1e-3 * k, pulse = k < 400 ? std::sin(M_PI * t / 0.4) : 0.0;
    trace.t.push_back(T(t));
    for (auto& V : trace.V) V.push_back(T(100 - 50 * pulse));
    for (auto& p : trace.p) p.push_back(T(5 + pulse));
    trace.p[LV].back() = scale * pulse;
    for (auto& Q : trace.Q) Q.push_back(T(100 * pulse));
  }
  return trace;
}
template <class T>
std::map<std::string, T> indexes(const T& scale) {
  std::map<std::string, T> all;
  for_each_index(compute_indexes_of(beat(scale), AtrialActivationsOf<T>{}, valve_debounce_s),
                 [&](const std::string& name, const char* unit, const T& value) {
                   if (name == "LV.pulse_area_mmHg_s") CHECK(std::string(unit) == "mmHg s");
                   all.emplace(name, value);
                 });
  return all;
}
}  // namespace

TEST_CASE("an index of one's own: by name, value and derivative") {
  const double area = 2 * 0.4 / M_PI;
  CHECK(indexes(120.0).at("LV.pulse_area_mmHg_s") == Approx(120 * area).epsilon(1e-5));
  CHECK(indexes(120.0).count("Qp_over_Qs") == 0);
  using D = Dual<1>;
  const D found = indexes(D::variable(120.0, 0)).at("LV.pulse_area_mmHg_s");
  CHECK(found.value == Approx(120 * area).epsilon(1e-5));
  CHECK(found.derivative[0] == Approx(area).epsilon(1e-5));
}
