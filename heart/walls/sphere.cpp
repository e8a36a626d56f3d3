#include <cmath>
#include <wiggers/heart/walls/sphere.hpp>

namespace wiggers {

namespace {

// Newton on the Legendre polynomial P_n from the Chebyshev guess.
template <int n>
GaussRule<n> make_rule() {
  GaussRule<n> rule{};
  for (int k = 0; k < n; ++k) {
    double x = std::cos(M_PI * (k + 0.75) / (n + 0.5));
    double slope = 0;
    for (int iteration = 0; iteration < 100; ++iteration) {
      double p0 = 1, p1 = x;
      for (int j = 2; j <= n; ++j) {
        const double p2 = ((2 * j - 1) * x * p1 - (j - 1) * p0) / j;
        p0 = p1;
        p1 = p2;
      }
      slope = n * (x * p1 - p0) / (x * x - 1);
      const double step = p1 / slope;
      x -= step;
      if (std::abs(step) < 1e-16) break;
    }
    rule.point[k] = 0.5 * (1 - x);
    rule.weight[k] = 1 / ((1 - x * x) * slope * slope);
  }
  return rule;
}

}  // namespace

const GaussRule<8>& gauss_8() {
  static const GaussRule<8> rule = make_rule<8>();
  return rule;
}
const GaussRule<64>& gauss_64() {
  static const GaussRule<64> rule = make_rule<64>();
  return rule;
}

}  // namespace wiggers
