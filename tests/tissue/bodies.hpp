// Meshes, rotations and fibres for the tests of the tissue.
#pragma once

#include <cmath>
#include <memory>
#include <random>
#include <vector>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/laws/tensor.hpp>
#include <wiggers/tissue/mesh/shapes.hpp>

namespace wiggers::bodies {

using Matrix = Matrix3<double>;

inline Vector3 times(const Matrix& a, const Vector3& x) {
  Vector3 y{};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) y[i] += a.m[i][k] * x[k];
  return y;
}

// About an axis that is none of the mesh's.
inline Matrix rotation(double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  const Vector3 n = (1 / std::sqrt(14.0)) * Vector3{1, -2, 3};
  Matrix R;
  const double cross[3][3] = {{0, -n[2], n[1]}, {n[2], 0, -n[0]}, {-n[1], n[0], 0}};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) R.m[i][k] = (i == k ? c : 0) + s * cross[i][k] + (1 - c) * n[i] * n[k];
  return R;
}

inline std::vector<double> random_numbers(std::size_t n, double size, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> entry(-size, size);
  std::vector<double> all(n);
  for (double& value : all) value = entry(random);
  return all;
}

// A box with every vertex moved by up to `share` of the spacing, tags of the sides kept.
inline TetMesh rough_box(const std::array<double, 3>& lengths, const std::array<int, 3>& n,
                         double share = 0.15, unsigned seed = 1) {
  TetMesh mesh = box_mesh({uniform(lengths[0], n[0]), uniform(lengths[1], n[1]), uniform(lengths[2], n[2])});
  const auto shift = random_numbers(3 * mesh.points.size(), share, seed);
  for (std::size_t p = 0; p < mesh.points.size(); ++p)
    for (std::size_t k = 0; k < 3; ++k) mesh.points[p][k] += shift[3 * p + k] * lengths[k] / n[k];
  return mesh;
}

inline std::shared_ptr<const TetMesh> shared(TetMesh mesh) {
  return std::make_shared<const TetMesh>(std::move(mesh));
}

inline TetMesh moved(TetMesh mesh, const Matrix& F) {
  for (Point3& p : mesh.points) p = times(F, p);
  return mesh;
}

// Fibres that turn along x, `twist` in 1/m, in frames that are themselves turned.
inline FibreField twisted_fibres(const TetMesh& mesh, double twist, const Matrix& R = rotation(0.4)) {
  FibreField field;
  for (const Point3& p : mesh.points) {
    const double c = std::cos(twist * p[0]), s = std::sin(twist * p[0]);
    field.frames.push_back({times(R, {c, s, 0}), times(R, {-s, c, 0}), times(R, {0, 0, 1})});
  }
  field.endocardial_distance.assign(mesh.points.size(), 1.0);
  return field;
}

inline double largest(const std::vector<double>& values) {
  double most = 0;
  for (double value : values) most = std::max(most, std::abs(value));
  return most;
}
inline double difference(const std::vector<double>& a, const std::vector<double>& b) {
  double most = a.size() == b.size() ? 0 : 1e300;
  for (std::size_t k = 0; k < a.size() && k < b.size(); ++k) most = std::max(most, std::abs(a[k] - b[k]));
  return most;
}

}  // namespace wiggers::bodies
