#include <fmt/format.h>
#include <petscksp.h>

#include <algorithm>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/parallel/algebra.hpp>

namespace wiggers {

namespace {

// Every return code is checked; what PETSc says is passed on.
void check(PetscErrorCode code, const char* what) {
  if (code == 0) return;
  const char* text = nullptr;
  PetscErrorMessage(code, &text, nullptr);
  throw NumericalFailure(fmt::format("PETSc failed in {}: {} (code {})", what, text ? text : "?", code));
}

}  // namespace

ParallelSession::ParallelSession(int* argc, char*** argv) {
  int provided = 0;
  MPI_Init_thread(argc, argv, MPI_THREAD_FUNNELED, &provided);
  PetscOptionsSetValue(nullptr, "-no_signal_handler", "true");
  check(PetscInitializeNoArguments(), "start");
  // Errors come back as codes, with no text of PETSc's own.
  check(PetscPushErrorHandler(PetscReturnErrorHandler, nullptr), "start");
}

ParallelSession::~ParallelSession() {
  PetscFinalize();
  MPI_Finalize();
}

NodeMatrix::NodeMatrix(const Partition& partition, const NodeSpace& space, int components)
    : partition_(partition), space_(space), components_(components), nodes_per_cell_(space.nodes_per_cell) {
  // Neighbours of each own node, as global numbers.
  std::vector<std::vector<int>> neighbours(space.n_own);
  const auto n_cells = static_cast<int>(partition.cells().size());
  for (int c = 0; c < n_cells; ++c) {
    if (!space.has(c)) continue;
    const auto nodes = space.nodes_of(c);
    for (int a : nodes)
      if (a < space.n_own)
        for (int b : nodes) neighbours[a].push_back(space.global(b));
  }
  std::vector<PetscInt> starts = {0}, columns;
  for (auto& row : neighbours) {
    std::sort(row.begin(), row.end());
    row.erase(std::unique(row.begin(), row.end()), row.end());
    columns.insert(columns.end(), row.begin(), row.end());
    starts.push_back(static_cast<PetscInt>(columns.size()));
  }
  const bool parallel = partition.n_ranks() > 1;
  check(MatCreate(partition.communicator(), &matrix_), "MatCreate");
  check(MatSetSizes(matrix_, space.n_own * components, space.n_own * components, PETSC_DECIDE, PETSC_DECIDE),
        "MatSetSizes");
  if (components == 1) {
    check(MatSetType(matrix_, parallel ? MATMPIAIJ : MATSEQAIJ), "MatSetType");
    check(parallel ? MatMPIAIJSetPreallocationCSR(matrix_, starts.data(), columns.data(), nullptr)
                   : MatSeqAIJSetPreallocationCSR(matrix_, starts.data(), columns.data(), nullptr),
          "preallocation");
  } else {
    check(MatSetType(matrix_, parallel ? MATMPIBAIJ : MATSEQBAIJ), "MatSetType");
    check(parallel
              ? MatMPIBAIJSetPreallocationCSR(matrix_, components, starts.data(), columns.data(), nullptr)
              : MatSeqBAIJSetPreallocationCSR(matrix_, components, starts.data(), columns.data(), nullptr),
          "preallocation");
  }
  const PetscInt* foreign_columns = nullptr;
  if (!parallel) {
    own_matrix_ = matrix_;
  } else if (components == 1) {
    check(MatMPIAIJGetSeqAIJ(matrix_, &own_matrix_, &foreign_matrix_, &foreign_columns), "parts");
  } else {
    check(MatMPIBAIJGetSeqBAIJ(matrix_, &own_matrix_, &foreign_matrix_, &foreign_columns), "parts");
  }
  check(MatSetOption(matrix_, MAT_NEW_NONZERO_LOCATION_ERR, PETSC_TRUE), "MatSetOption");

  // Within a row, the own block and the foreign one each hold their columns in ascending order.
  std::vector<int> own_start(space.n_own + 1, 0), foreign_start(space.n_own + 1, 0);
  const auto is_own = [&](int global) { return global >= space.first && global < space.first + space.n_own; };
  for (int a = 0; a < space.n_own; ++a) {
    const auto& row = neighbours[a];
    const auto n = static_cast<int>(std::count_if(row.begin(), row.end(), is_own));
    own_start[a + 1] = own_start[a] + n;
    foreign_start[a + 1] = foreign_start[a] + static_cast<int>(row.size()) - n;
  }
  n_diagonal_ = own_start.back();
  n_foreign_ = foreign_start.back();
  const auto slot_of = [&](int a, int b) {
    const auto& row = neighbours[a];
    const int global = space.global(b);
    const auto at = static_cast<int>(std::lower_bound(row.begin(), row.end(), global) - row.begin());
    const auto begin = static_cast<int>(std::lower_bound(row.begin(), row.end(), space.first) - row.begin());
    const int n = own_start[a + 1] - own_start[a];
    if (is_own(global)) return own_start[a] + at - begin;
    return n_diagonal_ + foreign_start[a] + (at < begin ? at : at - n);
  };
  slots_.assign(static_cast<std::size_t>(n_cells) * nodes_per_cell_ * nodes_per_cell_, -1);
  for (int c = 0; c < n_cells; ++c) {
    if (!space.has(c)) continue;
    const auto nodes = space.nodes_of(c);
    int* slots = &slots_[static_cast<std::size_t>(c) * nodes_per_cell_ * nodes_per_cell_];
    for (int a = 0; a < nodes_per_cell_; ++a)
      for (int b = 0; b < nodes_per_cell_; ++b)
        slots[a * nodes_per_cell_ + b] = nodes[a] < space.n_own ? slot_of(nodes[a], nodes[b]) : -1;
  }
  for (int a = 0; a < space.n_own; ++a) diagonal_.push_back(slot_of(a, a));

  check(MatCreateVecs(matrix_, &x_, &y_), "MatCreateVecs");
  set_zero();
  finish();
}

NodeMatrix::~NodeMatrix() {
  VecDestroy(&x_);
  VecDestroy(&y_);
  MatDestroy(&matrix_);
}

void NodeMatrix::set_zero() {
  check(MatZeroEntries(matrix_), "MatZeroEntries");
  const auto array_of = [&](Mat m, double** values) {
    check(components_ == 1 ? MatSeqAIJGetArray(m, values) : MatSeqBAIJGetArray(m, values), "values");
  };
  array_of(own_matrix_, &own_);
  if (foreign_matrix_) array_of(foreign_matrix_, &foreign_);
}

void NodeMatrix::finish() {
  const auto return_array = [&](Mat m, double** values) {
    check(components_ == 1 ? MatSeqAIJRestoreArray(m, values) : MatSeqBAIJRestoreArray(m, values), "values");
  };
  return_array(own_matrix_, &own_);
  if (foreign_matrix_) return_array(foreign_matrix_, &foreign_);
  check(MatAssemblyBegin(matrix_, MAT_FINAL_ASSEMBLY), "assembly");
  check(MatAssemblyEnd(matrix_, MAT_FINAL_ASSEMBLY), "assembly");
}

void NodeMatrix::multiply(const double* x, double* y) const {
  check(VecPlaceArray(x_, x), "vector");
  check(VecPlaceArray(y_, y), "vector");
  check(MatMult(matrix_, x_, y_), "product");
  check(VecResetArray(x_), "vector");
  check(VecResetArray(y_), "vector");
}

namespace {

// Translations and rotations, which no elastic energy resists: what multigrid must carry to its coarse grids.
void attach_rigid_body_modes(const NodeMatrix& matrix, ::Mat to) {
  const NodeSpace& space = matrix.space();
  ::Vec coordinates = nullptr;
  check(VecCreate(matrix.partition().communicator(), &coordinates), "coordinates");
  check(VecSetBlockSize(coordinates, 3), "coordinates");
  check(VecSetSizes(coordinates, 3 * space.n_own, PETSC_DECIDE), "coordinates");
  check(VecSetUp(coordinates), "coordinates");
  double* values = nullptr;
  check(VecGetArray(coordinates, &values), "coordinates");
  for (int a = 0; a < space.n_own; ++a)
    for (int k = 0; k < 3; ++k) values[3 * a + k] = space.points[a][k];
  check(VecRestoreArray(coordinates, &values), "coordinates");
  MatNullSpace modes = nullptr;
  check(MatNullSpaceCreateRigidBody(coordinates, &modes), "rigid-body modes");
  check(MatSetNearNullSpace(to, modes), "rigid-body modes");
  check(MatNullSpaceDestroy(&modes), "rigid-body modes");
  check(VecDestroy(&coordinates), "coordinates");
}

// Multigrid coarsens matrices of scalars only (PETSc 3.18), so it gets a copy; MatConvert would take the
// parts of a parallel original apart.
void copy_rows(::Mat from, ::Mat to) {
  PetscInt first = 0, end = 0, n = 0;
  const PetscInt* columns = nullptr;
  const PetscScalar* values = nullptr;
  check(MatGetOwnershipRange(from, &first, &end), "rows");
  for (PetscInt row = first; row < end; ++row) {
    check(MatGetRow(from, row, &n, &columns, &values), "rows");
    check(MatSetValues(to, 1, &row, n, columns, values, INSERT_VALUES), "rows");
    check(MatRestoreRow(from, row, &n, &columns, &values), "rows");
  }
  check(MatAssemblyBegin(to, MAT_FINAL_ASSEMBLY), "assembly");
  check(MatAssemblyEnd(to, MAT_FINAL_ASSEMBLY), "assembly");
}

::Mat scalar_copy(const NodeMatrix& matrix) {
  ::Mat from = matrix.handle(), copy = nullptr;
  PetscInt first = 0, end = 0, n = 0;
  const PetscInt* columns = nullptr;
  check(MatGetOwnershipRange(from, &first, &end), "rows");
  std::vector<PetscInt> own, foreign;
  for (PetscInt row = first; row < end; ++row) {
    check(MatGetRow(from, row, &n, &columns, nullptr), "rows");
    const auto inside =
        std::count_if(columns, columns + n, [&](PetscInt c) { return c >= first && c < end; });
    own.push_back(static_cast<PetscInt>(inside));
    foreign.push_back(static_cast<PetscInt>(n - inside));
    check(MatRestoreRow(from, row, &n, &columns, nullptr), "rows");
  }
  check(MatCreate(matrix.partition().communicator(), &copy), "MatCreate");
  check(MatSetSizes(copy, end - first, end - first, PETSC_DECIDE, PETSC_DECIDE), "MatSetSizes");
  check(MatSetBlockSize(copy, matrix.components()), "MatSetBlockSize");
  check(MatSetType(copy, MATAIJ), "MatSetType");
  check(MatSeqAIJSetPreallocation(copy, 0, own.data()), "preallocation");
  check(MatMPIAIJSetPreallocation(copy, 0, own.data(), 0, foreign.data()), "preallocation");
  copy_rows(from, copy);
  return copy;
}

}  // namespace

LinearSolver::LinearSolver(const NodeMatrix& matrix, SolverKind kind) : matrix_(matrix), kind_(kind) {
  check(KSPCreate(matrix.partition().communicator(), &solver_), "KSPCreate");
  PC preconditioner = nullptr;
  check(KSPGetPC(solver_, &preconditioner), "KSPGetPC");
  switch (kind) {
    case SolverKind::cg_jacobi:
    case SolverKind::cg_ilu:
      check(KSPSetType(solver_, KSPCG), "KSPSetType");
      check(KSPSetNormType(solver_, KSP_NORM_UNPRECONDITIONED), "norm");
      check(PCSetType(preconditioner, kind == SolverKind::cg_jacobi ? PCJACOBI : PCBJACOBI), "PCSetType");
      break;
    case SolverKind::gmres_ilu:
    case SolverKind::gmres_gamg:
      check(KSPSetType(solver_, KSPGMRES), "KSPSetType");
      check(KSPGMRESSetRestart(solver_, kind == SolverKind::gmres_gamg ? 60 : 150), "restart");
      check(KSPSetPCSide(solver_, PC_RIGHT), "side");  // so that the residual is the true one
      if (kind == SolverKind::gmres_gamg) {
        scalars_ = scalar_copy(matrix);
        attach_rigid_body_modes(matrix, scalars_);
        choose_multigrid();
      } else {
        check(PCSetType(preconditioner, PCBJACOBI), "PCSetType");
      }
      break;
    case SolverKind::direct:
      check(KSPSetType(solver_, KSPGMRES), "KSPSetType");
      check(KSPSetPCSide(solver_, PC_RIGHT), "side");
      check(PCSetType(preconditioner, PCLU), "PCSetType");
      check(PCFactorSetMatSolverType(preconditioner, MATSOLVERMUMPS), "MUMPS");
      break;
  }
  check(KSPSetInitialGuessNonzero(solver_, PETSC_TRUE), "guess");
  set_operators();
  check(MatCreateVecs(matrix.handle(), &x_, &b_), "MatCreateVecs");
}

LinearSolver::~LinearSolver() {
  VecDestroy(&x_);
  VecDestroy(&b_);
  KSPDestroy(&solver_);
  MatDestroy(&scalars_);
}

void LinearSolver::choose_multigrid() {
  PC preconditioner = nullptr;
  check(KSPGetPC(solver_, &preconditioner), "KSPGetPC");
  // Through another type, so that nothing is left of a hierarchy that was there: a reset alone leaves some of
  // it (PETSc 3.18).
  check(PCSetType(preconditioner, PCNONE), "PCSetType");
  check(PCSetType(preconditioner, PCGAMG), "PCSetType");
  // Small coarse grids: three times cheaper an iteration than none aggressive, and as many iterations.
  check(PCGAMGSetAggressiveLevels(preconditioner, 2), "coarsening");
  check(PCGAMGSetReuseInterpolation(preconditioner, PETSC_TRUE), "interpolation");
}

// Said anew whenever the preconditioner is to be rebuilt: PETSc would rebuild it only within the first
// product with it else, and never after a failed one.
void LinearSolver::set_operators() {
  check(KSPSetOperators(solver_, matrix_.handle(), scalars_ ? scalars_ : matrix_.handle()), "operators");
}

void LinearSolver::keep(bool preconditioner) {
  check(KSPSetReusePreconditioner(solver_, preconditioner ? PETSC_TRUE : PETSC_FALSE), "reuse");
  kept_ = preconditioner;
}

void LinearSolver::matrix_changed() {
  if (built_)
    keep(true);
  else
    renew();
  set_operators();
}

void LinearSolver::renew() {
  keep(false);
  when_new_ = 0;
  if (scalars_) copy_rows(matrix_.handle(), scalars_);
  set_operators();
}

void LinearSolver::forget() {
  check(KSPReset(solver_), "reset");
  if (kind_ == SolverKind::gmres_gamg) choose_multigrid();
  built_ = false;
  renew();
}

SolveReport LinearSolver::solve(const double* b, double* x, double relative, double absolute,
                                int max_iterations) {
  const std::vector<double> guess(x,
                                  x + static_cast<std::size_t>(matrix_.space().n_own) * matrix_.components());
  if (kind_ == SolverKind::direct) max_iterations = most_iterations_with_factors;
  const bool watched = kind_ == SolverKind::gmres_gamg && kept_;
  SolveReport report = iterate(b, x, relative, absolute,
                               watched ? std::min(max_iterations, 2 * worn * when_new_) : max_iterations);
  if (!report.converged && kept_) {
    const int in_vain = report.iterations;
    std::copy(guess.begin(), guess.end(), x);
    renew();
    report = iterate(b, x, relative, absolute, max_iterations);
    report.iterations += in_vain;
  }
  // What was found worn stays so until it is renewed, however easy the next system is.
  if (!kept_ || !report.converged) built_ = lasts() && report.converged;
  if (kind_ == SolverKind::gmres_gamg && report.converged) {
    if (!kept_) when_new_ = std::max({when_new_, report.iterations, fewest_when_new});
    if (kept_ && report.iterations > worn * when_new_) built_ = false;  // the next matrix gets its own
  }
  if (!report.converged) {
    std::copy(guess.begin(), guess.end(), x);
    forget();  // what failed would be taken for failed for ever
  }
  return report;
}

SolveReport LinearSolver::iterate(const double* b, double* x, double relative, double absolute,
                                  int max_iterations) {
  check(VecPlaceArray(b_, b), "vector");
  check(VecPlaceArray(x_, x), "vector");
  check(KSPSetTolerances(solver_, relative, std::max(absolute, 1e-300), 1e10, max_iterations), "tolerances");
  const PetscErrorCode code = KSPSolve(solver_, b_, x_);
  KSPConvergedReason reason = KSP_CONVERGED_ITERATING;
  PetscInt iterations = 0;
  KSPGetConvergedReason(solver_, &reason);
  KSPGetIterationNumber(solver_, &iterations);
  check(VecResetArray(b_), "vector");
  check(VecResetArray(x_), "vector");
  SolveReport report;
  report.iterations = static_cast<int>(iterations);
  report.converged = code == 0 && reason > 0;
  if (!report.converged) {
    const char* text = nullptr;
    if (code) PetscErrorMessage(code, &text, nullptr);
    report.reason =
        fmt::format("{} after {} iterations ({})", solver_kind_names[static_cast<int>(kind_)],
                    report.iterations, code ? (text ? text : "error") : KSPConvergedReasons[reason]);
  }
  return report;
}

}  // namespace wiggers
