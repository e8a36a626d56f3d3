// Matrices on nodes, written in place, and the solvers for them: PETSc called directly.
//
// A matrix has one block of components x components numbers for each pair of nodes that share a cell. Element
// code looks its slots up once (cell_slots) and adds to them; no row of another rank is ever touched, because
// ghost cells are assembled, too.
//
// PETSc's types are named by their structs: its headers put `Vec` and `Mat` into the global namespace.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/tissue/parallel/partition.hpp>

struct _p_Mat;
struct _p_Vec;
struct _p_KSP;

namespace wiggers {

class NodeMatrix {
 public:
  // Collective. `components` 1 or 3.
  NodeMatrix(const Partition& partition, const NodeSpace& space, int components);
  ~NodeMatrix();
  NodeMatrix(const NodeMatrix&) = delete;
  NodeMatrix& operator=(const NodeMatrix&) = delete;

  // Slots of a local cell, row-major over its nodes; -1 where the row belongs to another rank.
  const int* cell_slots(int cell) const {
    return &slots_[static_cast<std::size_t>(cell) * nodes_per_cell_ * nodes_per_cell_];
  }
  int diagonal_slot(int own_node) const { return diagonal_[own_node]; }
  // The numbers of a slot: column-major for three components.
  double* block(int slot) {
    const int size = components_ * components_;
    return slot < n_diagonal_ ? own_ + static_cast<std::ptrdiff_t>(slot) * size
                              : foreign_ + static_cast<std::ptrdiff_t>(slot - n_diagonal_) * size;
  }
  // Between set_zero() and finish() the blocks may be written.
  void set_zero();
  void finish();

  // y = A x, both of own nodes. Collective.
  void multiply(const double* x, double* y) const;

  int components() const { return components_; }
  const Partition& partition() const { return partition_; }
  const NodeSpace& space() const { return space_; }
  _p_Mat* handle() const { return matrix_; }
  // Numbers stored by this rank.
  std::size_t stored() const {
    return static_cast<std::size_t>(n_diagonal_ + n_foreign_) * components_ * components_;
  }

 private:
  const Partition& partition_;
  const NodeSpace& space_;
  int components_, nodes_per_cell_;
  _p_Mat *matrix_ = nullptr, *own_matrix_ = nullptr, *foreign_matrix_ = nullptr;
  mutable _p_Vec *x_ = nullptr, *y_ = nullptr;
  double *own_ = nullptr, *foreign_ = nullptr;
  int n_diagonal_ = 0, n_foreign_ = 0;
  std::vector<int> slots_, diagonal_;
};

enum class SolverKind {
  cg_jacobi,   // symmetric positive definite
  cg_ilu,      // the same, with incomplete factors of each rank's block
  gmres_ilu,   // any, dynamic mechanics
  gmres_gamg,  // mechanics of bodies with stiff parts, and of large meshes: algebraic multigrid with
               // rigid-body modes, which serves later matrices while it does so well
  direct       // GMRES on complete factors (MUMPS), which serve later matrices while a few iterations do
};
inline constexpr std::array<std::string_view, 5> solver_kind_names = {"cg-jacobi", "cg-ilu", "gmres-ilu",
                                                                      "gmres-gamg", "direct"};

struct SolveReport {
  int iterations = 0;
  bool converged = false;
  std::string reason;
};

class LinearSolver {
 public:
  // Collective. The matrix must outlive the solver.
  LinearSolver(const NodeMatrix& matrix, SolverKind kind);
  ~LinearSolver();
  LinearSolver(const LinearSolver&) = delete;
  LinearSolver& operator=(const LinearSolver&) = delete;

  // The matrix has new values: the preconditioner is rebuilt at the next solve, complete factors and
  // multigrid only when they do not serve any more.
  void matrix_changed();
  // The next solve owes nothing to earlier matrices.
  void forget();
  // Solves A x = b to |b - A x| <= max(relative |b|, absolute) in the true norm; x is the first guess, and is
  // left as it was where the solver does not converge. Complete factors take few iterations or fail:
  // `max_iterations` is of the other solvers. Collective.
  SolveReport solve(const double* b, double* x, double relative, double absolute, int max_iterations = 1000);

 private:
  // Making the factors costs more than this many iterations with them.
  static constexpr int most_iterations_with_factors = 15;
  // Building multigrid costs some ten to twenty iterations with it: it is kept while a solve takes less than
  // this many times those of a new one, and given up within a solve at twice that.
  static constexpr int worn = 2, fewest_when_new = 8;
  void choose_multigrid();
  bool lasts() const { return kind_ == SolverKind::direct || kind_ == SolverKind::gmres_gamg; }
  void renew();
  void set_operators();
  void keep(bool preconditioner);
  SolveReport iterate(const double* b, double* x, double relative, double absolute, int max_iterations);

  const NodeMatrix& matrix_;
  SolverKind kind_;
  bool built_ = false;  // complete factors or multigrid of this or an earlier matrix are there
  bool kept_ = false;   // the preconditioner is of an earlier matrix
  int when_new_ = 0;    // iterations of the first solve with it
  _p_KSP* solver_ = nullptr;
  _p_Mat* scalars_ = nullptr;  // what multigrid coarsens
  _p_Vec *b_ = nullptr, *x_ = nullptr;
};

// MPI and PETSc, started once a process, ended with the object.
class ParallelSession {
 public:
  ParallelSession(int* argc, char*** argv);
  ~ParallelSession();
};

}  // namespace wiggers
