// The root of a function between two points of opposite sign: regula falsi with halving (Illinois).
#pragma once

#include <cmath>

namespace wiggers {

// f(a) = fa and f(b) = fb differ in sign. Ends where |f| < small, or where the bracket is shorter than
// `width`: then with its end on b's side.
template <class Function>
double bracketed_root(Function f, double a, double b, double fa, double fb, double small, double width) {
  int last = 0;
  for (int k = 0; k < 100 && b - a > width; ++k) {
    const double c = fb == fa ? 0.5 * (a + b) : (a * fb - b * fa) / (fb - fa), fc = f(c);
    if (std::abs(fc) < small) return c;
    if ((fc > 0) == (fb > 0)) {
      b = c;
      fb = fc;
      if (last == -1) fa *= 0.5;
      last = -1;
    } else {
      a = c;
      fa = fc;
      if (last == 1) fb *= 0.5;
      last = 1;
    }
  }
  return b;
}

}  // namespace wiggers
