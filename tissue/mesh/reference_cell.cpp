#include <cmath>
#include <stdexcept>
#include <wiggers/tissue/mesh/reference_cell.hpp>

namespace wiggers {

namespace {

// All permutations of a barycentric point of the form (a, b, b, b) or (a, a, b, b), and their like on
// triangles.
template <int corners>
void add_orbit(std::vector<QuadraturePoint<corners>>& points, double weight, double odd, double even) {
  for (int k = 0; k < corners; ++k) {
    QuadraturePoint<corners> p{{}, weight};
    p.at.fill(even);
    p.at[k] = odd;
    points.push_back(p);
  }
}
void add_pairs(std::vector<QuadraturePoint<4>>& points, double weight, double a, double b) {
  for (int k = 0; k < 4; ++k)
    for (int l = k + 1; l < 4; ++l) {
      QuadraturePoint<4> p{{}, weight};
      p.at.fill(b);
      p.at[k] = p.at[l] = a;
      points.push_back(p);
    }
}

}  // namespace

// Rules of Keast (1986) and Walkington; positive weights but for none.
const std::vector<QuadraturePoint<4>>& tetrahedron_quadrature(int degree) {
  static const std::vector<QuadraturePoint<4>> one = {{{0.25, 0.25, 0.25, 0.25}, 1}};
  static const std::vector<QuadraturePoint<4>> two = [] {
    std::vector<QuadraturePoint<4>> points;
    const double root = std::sqrt(5.0);
    add_orbit<4>(points, 0.25, (5 + 3 * root) / 20, (5 - root) / 20);
    return points;
  }();
  // 14 points of degree 5 with positive weights (Walkington 2000).
  static const std::vector<QuadraturePoint<4>> five = [] {
    std::vector<QuadraturePoint<4>> points;
    const double a1 = 0.31088591926330060980, a2 = 0.092735250310891226402, a3 = 0.045503704125649649492;
    const double w1 = 0.018781320953002641800, w2 = 0.012248840519393658257, w3 = 0.0070910034628469110730;
    add_orbit<4>(points, 6 * w1, 1 - 3 * a1, a1);
    add_orbit<4>(points, 6 * w2, 1 - 3 * a2, a2);
    add_pairs(points, 6 * w3, 0.5 - a3, a3);
    return points;
  }();
  if (degree <= 1) return one;
  if (degree == 2) return two;
  if (degree <= 5) return five;
  throw std::logic_error("no quadrature of this degree");
}

// Rules of Strang and Fix, and Dunavant.
const std::vector<QuadraturePoint<3>>& triangle_quadrature(int degree) {
  static const std::vector<QuadraturePoint<3>> one = {{{1.0 / 3, 1.0 / 3, 1.0 / 3}, 1}};
  static const std::vector<QuadraturePoint<3>> two = [] {
    std::vector<QuadraturePoint<3>> points;
    add_orbit<3>(points, 1.0 / 3, 2.0 / 3, 1.0 / 6);
    return points;
  }();
  static const std::vector<QuadraturePoint<3>> five = [] {
    std::vector<QuadraturePoint<3>> points = {{{1.0 / 3, 1.0 / 3, 1.0 / 3}, 0.225}};
    const double root = std::sqrt(15.0);
    add_orbit<3>(points, (155 + root) / 1200, 1 - 2 * (6 + root) / 21, (6 + root) / 21);
    add_orbit<3>(points, (155 - root) / 1200, 1 - 2 * (6 - root) / 21, (6 - root) / 21);
    return points;
  }();
  if (degree <= 1) return one;
  if (degree == 2) return two;
  if (degree <= 5) return five;
  throw std::logic_error("no quadrature of this degree");
}

}  // namespace wiggers
