#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/tissue/fibres/laplace.hpp>
#include <wiggers/tissue/laws/tensor.hpp>

namespace wiggers {

namespace {

std::size_t at(int i) { return static_cast<std::size_t>(i); }

Eigen::MatrixXd solve_directly(const Eigen::SparseMatrix<double>& matrix, const Eigen::MatrixXd& right) {
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(matrix);
  if (solver.info() != Eigen::Success)
    throw NumericalFailure(
        "Laplace problem: the matrix cannot be factorised; the mesh has cells without volume (see `wiggers "
        "mesh check`)");
  return solver.solve(right);
}

Eigen::MatrixXd solve_iteratively(const Eigen::SparseMatrix<double>& matrix, const Eigen::MatrixXd& right) {
  constexpr double relative_residual = 1e-12;
  Eigen::ConjugateGradient<Eigen::SparseMatrix<double>, Eigen::Lower | Eigen::Upper,
                           Eigen::IncompleteCholesky<double>>
      solver;
  solver.setTolerance(relative_residual);
  solver.setMaxIterations(3000);
  solver.compute(matrix);
  if (solver.info() != Eigen::Success) return solve_directly(matrix, right);
  Eigen::MatrixXd solution(right.rows(), right.cols());
  for (Eigen::Index column = 0; column < right.cols(); ++column) {
    check_interrupt();
    solution.col(column) = solver.solve(right.col(column));
    if (solver.info() != Eigen::Success) return solve_directly(matrix, right);
  }
  return solution;
}

}  // namespace

CellGeometry cell_geometry(const TetMesh& mesh, int cell) {
  const auto& v = mesh.cells[at(cell)];
  const Point3 a = mesh.points[at(v[0])];
  const Vector3 p = mesh.points[at(v[1])] - a, q = mesh.points[at(v[2])] - a, r = mesh.points[at(v[3])] - a;
  const double six_volumes = dot(cross(p, q), r);
  CellGeometry g;
  g.volume = six_volumes / 6;
  g.gradients[1] = 1 / six_volumes * cross(q, r);
  g.gradients[2] = 1 / six_volumes * cross(r, p);
  g.gradients[3] = 1 / six_volumes * cross(p, q);
  g.gradients[0] = -1.0 * (g.gradients[1] + g.gradients[2] + g.gradients[3]);
  return g;
}

LaplaceProblem::LaplaceProblem(const TetMesh& mesh, std::vector<int> region_tags)
    : mesh_(mesh),
      region_name_(
          fmt::format("volume{} {}", region_tags.size() == 1 ? "" : "s", fmt::join(region_tags, ", "))),
      cell_in_region_(mesh.cells.size(), 0),
      local_number_(mesh.points.size(), -1) {
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    cell_in_region_[c] =
        std::find(region_tags.begin(), region_tags.end(), mesh.cell_tags[c]) != region_tags.end();
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (cell_in_region_[c])
      for (int v : mesh.cells[c]) local_number_[at(v)] = 0;
  for (std::size_t v = 0; v < local_number_.size(); ++v)
    if (local_number_[v] == 0) {
      local_number_[v] = static_cast<int>(vertices_.size());
      vertices_.push_back(static_cast<int>(v));
    }
  if (vertices_.empty()) throw InputError(fmt::format("the mesh has no cell in {}", region_name_));

  std::vector<Eigen::Triplet<double>> entries;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    if (!cell_in_region_[c]) continue;
    const CellGeometry g = cell_geometry(mesh, static_cast<int>(c));
    if (!(g.volume > 0))
      throw InputError(
          fmt::format("cell {} of the mesh has the volume {:.3e} m3; it must be positive", c, g.volume));
    for (std::size_t i = 0; i < 4; ++i)
      for (std::size_t j = 0; j < 4; ++j)
        entries.emplace_back(local_number_[at(mesh.cells[c][i])], local_number_[at(mesh.cells[c][j])],
                             g.volume * dot(g.gradients[i], g.gradients[j]));
  }
  stiffness_.resize(region_vertices(), region_vertices());
  stiffness_.setFromTriplets(entries.begin(), entries.end());
}

void LaplaceProblem::refuse_floating_parts(const std::vector<char>& fixed) const {
  std::vector<char> reached = fixed;
  std::vector<int> stack;
  for (int v = 0; v < region_vertices(); ++v)
    if (fixed[at(v)]) stack.push_back(v);
  while (!stack.empty()) {
    const int v = stack.back();
    stack.pop_back();
    for (Eigen::SparseMatrix<double>::InnerIterator entry(stiffness_, v); entry; ++entry)
      if (!reached[at(static_cast<int>(entry.row()))]) {
        reached[at(static_cast<int>(entry.row()))] = 1;
        stack.push_back(static_cast<int>(entry.row()));
      }
  }
  for (int v = 0; v < region_vertices(); ++v)
    if (!reached[at(v)]) {
      const Point3& p = mesh_.points[at(vertices_[at(v)])];
      throw InputError(fmt::format(
          "{} of the mesh falls apart, and the part around ({:.4g}, {:.4g}, {:.4g}) m touches none "
          "of the boundary sets: are its surfaces tagged?",
          region_name_, p[0], p[1], p[2]));
    }
}

std::vector<std::vector<double>> LaplaceProblem::solve_several(
    std::span<const BoundarySet> sets, const std::vector<std::vector<double>>& values) const {
  const int n = region_vertices();
  std::vector<int> set_of(at(n), -1);
  for (std::size_t s = 0; s < sets.size(); ++s) {
    bool touches = false;
    for (int v : sets[s].vertices) {
      const int local = local_number_[at(v)];
      if (local < 0) continue;
      touches = true;
      if (set_of[at(local)] < 0) set_of[at(local)] = static_cast<int>(s);
    }
    if (!touches)
      throw InputError(
          fmt::format("boundary set '{}' has no vertex in {} of the mesh", sets[s].name, region_name_));
  }
  std::vector<char> fixed(at(n));
  std::vector<int> free_number(at(n), -1);
  int n_free = 0;
  for (int v = 0; v < n; ++v) {
    fixed[at(v)] = set_of[at(v)] >= 0;
    if (!fixed[at(v)]) free_number[at(v)] = n_free++;
  }
  refuse_floating_parts(fixed);

  const auto n_fields = static_cast<Eigen::Index>(values.size());
  Eigen::MatrixXd right = Eigen::MatrixXd::Zero(n_free, n_fields);
  std::vector<Eigen::Triplet<double>> entries;
  for (int column = 0; column < n; ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator entry(stiffness_, column); entry; ++entry) {
      const int row = free_number[at(static_cast<int>(entry.row()))];
      if (row < 0) continue;
      if (!fixed[at(column)])
        entries.emplace_back(row, free_number[at(column)], entry.value());
      else
        for (Eigen::Index k = 0; k < n_fields; ++k)
          right(row, k) -= entry.value() * values[at(static_cast<int>(k))].at(at(set_of[at(column)]));
    }
  Eigen::MatrixXd solution(n_free, n_fields);
  if (n_free > 0) {
    Eigen::SparseMatrix<double> matrix(n_free, n_free);
    matrix.setFromTriplets(entries.begin(), entries.end());
    entries = {};
    solution =
        n_free <= direct_solver_limit ? solve_directly(matrix, right) : solve_iteratively(matrix, right);
  }

  std::vector<std::vector<double>> fields(values.size(), std::vector<double>(mesh_.points.size(), 0));
  for (std::size_t k = 0; k < values.size(); ++k) {
    const auto [lowest, highest] = std::minmax_element(values[k].begin(), values[k].end());
    for (int v = 0; v < n; ++v)
      fields[k][at(vertices_[at(v)])] =
          fixed[at(v)]
              ? values[k][at(set_of[at(v)])]
              : std::clamp(solution(free_number[at(v)], static_cast<Eigen::Index>(k)), *lowest, *highest);
  }
  return fields;
}

std::vector<double> LaplaceProblem::solve(std::span<const BoundarySet> sets,
                                          const std::vector<double>& values) const {
  return solve_several(sets, {values})[0];
}

std::vector<Point3> LaplaceProblem::cell_gradients(const std::vector<double>& field) const {
  std::vector<Point3> gradients(mesh_.cells.size(), Point3{});
  for (std::size_t c = 0; c < mesh_.cells.size(); ++c) {
    if (!cell_in_region_[c]) continue;
    const CellGeometry g = cell_geometry(mesh_, static_cast<int>(c));
    for (std::size_t i = 0; i < 4; ++i)
      gradients[c] = gradients[c] + field[at(mesh_.cells[c][i])] * g.gradients[i];
  }
  return gradients;
}

std::vector<Point3> LaplaceProblem::vertex_gradients(const std::vector<double>& field) const {
  const std::vector<Point3> of_cell = cell_gradients(field);
  std::vector<Point3> gradients(mesh_.points.size(), Point3{});
  std::vector<double> volumes(mesh_.points.size(), 0);
  for (std::size_t c = 0; c < mesh_.cells.size(); ++c) {
    if (!cell_in_region_[c]) continue;
    const double volume = cell_geometry(mesh_, static_cast<int>(c)).volume;
    for (int v : mesh_.cells[c]) {
      gradients[at(v)] = gradients[at(v)] + volume * of_cell[c];
      volumes[at(v)] += volume;
    }
  }
  for (std::size_t v = 0; v < gradients.size(); ++v)
    if (volumes[v] > 0) gradients[v] = 1 / volumes[v] * gradients[v];
  return gradients;
}

}  // namespace wiggers
