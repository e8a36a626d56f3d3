// Laplace problems on a mesh: the scalar fields that rule-based fibres are built from.
//
//   -lap u = 0 in a region,  u = given on some vertices,  zero normal derivative on the rest of its boundary
//
// with continuous linear elements (P1). The stiffness matrix of a region is assembled once; each choice of
// constrained vertices is factorised once and serves any number of boundary values. Up to
// `direct_solver_limit` unknowns a sparse Cholesky factorisation (LDLT) is used, above that conjugate
// gradients with an incomplete Cholesky factorisation, to a relative residual of 1e-12; where those do not
// converge (very poor cells) the factorisation takes over.
//
// Every problem is solved on the whole mesh, which each process holds: the fields do not depend on the number
// of processes, to the last bit.
#pragma once

#include <Eigen/SparseCore>
#include <span>
#include <string>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// Vertices that share one prescribed value. The name is for people: "endocardium-LV (surface 24)".
struct BoundarySet {
  std::string name;
  std::vector<int> vertices;  // numbers of the mesh; those outside the region are ignored
};

class LaplaceProblem {
 public:
  // The factors of three-dimensional meshes fill in: measured on an ellipsoid with 19 000 and 56 000
  // vertices, LDLT takes 0.6 and 9.6 s, conjugate gradients 0.14 and 0.7 s, and both agree to 3e-12.
  static constexpr int direct_solver_limit = 5000;

  // The region consists of all cells with one of these tags. `mesh` must outlive the problem.
  LaplaceProblem(const TetMesh& mesh, std::vector<int> region_tags);

  // One field for each row of `values`; values[field][set] is the value on sets[set]. A vertex in two sets
  // takes the value of the first. Fields have an entry for each vertex of the mesh (0 outside the region) and
  // obey the maximum principle: overshoots of obtuse cells are cut off.
  // Refuses (InputError) a set without a vertex in the region, and a region of which a separate part is
  // touched by none of the sets.
  std::vector<std::vector<double>> solve_several(std::span<const BoundarySet> sets,
                                                 const std::vector<std::vector<double>>& values) const;
  std::vector<double> solve(std::span<const BoundarySet> sets, const std::vector<double>& values) const;

  // Constant gradient of a P1 field in each cell (zero outside the region).
  std::vector<Point3> cell_gradients(const std::vector<double>& field) const;
  // Its mean over the cells of the region around each vertex, weighted with their volumes.
  std::vector<Point3> vertex_gradients(const std::vector<double>& field) const;

  bool in_region(int vertex) const { return local_number_[static_cast<std::size_t>(vertex)] >= 0; }
  bool cell_in_region(int cell) const { return cell_in_region_[static_cast<std::size_t>(cell)]; }
  int region_vertices() const { return static_cast<int>(vertices_.size()); }

 private:
  void refuse_floating_parts(const std::vector<char>& fixed) const;

  const TetMesh& mesh_;
  std::string region_name_;
  std::vector<char> cell_in_region_;
  std::vector<int> local_number_;  // of each mesh vertex; -1 outside the region
  std::vector<int> vertices_;      // mesh number of each local vertex
  Eigen::SparseMatrix<double> stiffness_;
};

// Volume (m3) of a cell and the gradients (1/m) of its four shape functions.
struct CellGeometry {
  double volume;
  std::array<Point3, 4> gradients;
};
CellGeometry cell_geometry(const TetMesh& mesh, int cell);

}  // namespace wiggers
