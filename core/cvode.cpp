#include <cvodes/cvodes.h>
#include <fmt/format.h>
#include <nvector/nvector_serial.h>
#include <sundials/sundials_context.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_dense.h>

#include <cmath>
#include <cstring>
#include <wiggers/core/carried_exception.hpp>
#include <wiggers/core/cvode.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

namespace {

std::string reason(int code) {
  switch (code) {
    case CV_TOO_MUCH_WORK:
      return "too many internal steps";
    case CV_TOO_MUCH_ACC:
      return "the tolerance is below what double precision can deliver";
    case CV_ERR_FAILURE:
      return "error test failed repeatedly";
    case CV_CONV_FAILURE:
      return "Newton iteration failed repeatedly";
    case CV_RHSFUNC_FAIL:
    case CV_UNREC_RHSFUNC_ERR:
      return "the right-hand side could not be evaluated";
    case CV_FIRST_RHSFUNC_ERR:
    case CV_REPTD_RHSFUNC_ERR:
      return "the right-hand side stays non-finite";
    case CV_LSETUP_FAIL:
    case CV_LSOLVE_FAIL:
      return "the linear solve failed";
    case CV_TOO_CLOSE:
      return "the interval is too short to step over";
    default:
      break;
  }
  char* name = CVodeGetReturnFlagName(code);
  std::string text = name ? name : "unknown";
  std::free(name);
  return text;
}

}  // namespace

struct Cvode::Implementation {
  OdeSystem system;
  OdeTolerances tolerances;
  std::vector<double> state;
  SUNContext context = nullptr;
  N_Vector y = nullptr;
  N_Vector absolute = nullptr;
  SUNMatrix matrix = nullptr;
  SUNLinearSolver linear_solver = nullptr;
  void* memory = nullptr;
  bool started = false;
  double t = 0;
  double start_time = 0;
  CarriedException carried;
  unsigned evaluations = 0;
  N_Vector* directions = nullptr;
  AdaptiveCounts before_restart;

  ~Implementation() {
    if (memory) CVodeFree(&memory);
    if (linear_solver) SUNLinSolFree(linear_solver);
    if (matrix) SUNMatDestroy(matrix);
    if (directions) N_VDestroyVectorArray(directions, static_cast<int>(system.n_directions));
    if (y) N_VDestroy(y);
    if (absolute) N_VDestroy(absolute);
    if (context) SUNContext_Free(&context);
  }

  void check(int code, const char* call) {
    if (code >= 0) return;
    carried.rethrow();
    throw NumericalFailure(fmt::format(
        "time integration failed at t = {}: {} ({}). Try a looser relative tolerance (now {}) or check the "
        "inputs near that time.",
        t, reason(code), call, tolerances.relative));
  }
  template <class Pointer>
  Pointer* check_pointer(Pointer* pointer, const char* call) {
    if (!pointer) throw ResourceError(fmt::format("{}: out of memory", call));
    return pointer;
  }

  static int derivative(double t, N_Vector y, N_Vector dy, void* user) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      if ((++self->evaluations & 63) == 0) check_interrupt();
      double* out = N_VGetArrayPointer(dy);
      self->system.derivative(t, N_VGetArrayPointer(y), out);
      for (std::size_t i = 0; i < self->system.size; ++i)
        if (!std::isfinite(out[i])) return 1;  // recoverable: the step is cut
      return 0;
    });
  }
  static int jacobian(double t, N_Vector y, N_Vector, SUNMatrix matrix, void* user, N_Vector, N_Vector,
                      N_Vector) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      self->system.jacobian(t, N_VGetArrayPointer(y), SUNDenseMatrix_Data(matrix));
      return 0;
    });
  }
  static int roots(double t, N_Vector y, double* values, void* user) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      self->system.roots(t, N_VGetArrayPointer(y), values);
      return 0;
    });
  }
  // The vectors of a SUNDIALS array as plain pointers.
  std::vector<double*> pointers(N_Vector* vectors) const {
    std::vector<double*> list;
    for (std::size_t k = 0; k < system.n_directions; ++k) list.push_back(N_VGetArrayPointer(vectors[k]));
    return list;
  }
  static int variation(int, double t, N_Vector y, N_Vector, N_Vector* S, N_Vector* dS, void* user, N_Vector,
                       N_Vector) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      self->system.variation(t, N_VGetArrayPointer(y), self->pointers(S).data(), self->pointers(dS).data());
      return 0;
    });
  }
  static void silent(int, const char*, const char*, char*, void*) {}  // errors are reported by check()
};

Cvode::Cvode(OdeSystem system, OdeTolerances tolerances)
    : implementation_(std::make_unique<Implementation>()) {
  Implementation& m = *implementation_;
  m.system = std::move(system);
  m.tolerances = std::move(tolerances);
  const auto n = static_cast<sunindextype>(m.system.size);
  m.state.assign(m.system.size, 0.0);
  if (SUNContext_Create(nullptr, &m.context) < 0) throw ResourceError("SUNContext_Create: out of memory");
  m.y = m.check_pointer(N_VMake_Serial(n, m.state.data(), m.context), "N_VMake_Serial");
  m.absolute = m.check_pointer(N_VNew_Serial(n, m.context), "N_VNew_Serial");
  std::memcpy(N_VGetArrayPointer(m.absolute), m.tolerances.absolute.data(), m.system.size * sizeof(double));
  m.memory = m.check_pointer(CVodeCreate(CV_BDF, m.context), "CVodeCreate");
  m.matrix = m.check_pointer(SUNDenseMatrix(n, n, m.context), "SUNDenseMatrix");
  m.linear_solver = m.check_pointer(SUNLinSol_Dense(m.y, m.matrix, m.context), "SUNLinSol_Dense");
  m.check(CVodeSetErrHandlerFn(m.memory, Implementation::silent, nullptr), "CVodeSetErrHandlerFn");
}

Cvode::~Cvode() = default;

void Cvode::set_directions(const std::vector<std::vector<double>>& values) {
  Implementation& m = *implementation_;
  const int n = static_cast<int>(m.system.n_directions);
  if (!m.directions) m.directions = m.check_pointer(N_VCloneVectorArray(n, m.y), "N_VCloneVectorArray");
  for (std::size_t k = 0; k < values.size(); ++k)
    std::copy(values[k].begin(), values[k].end(), N_VGetArrayPointer(m.directions[k]));
}

std::vector<std::vector<double>> Cvode::directions() {
  Implementation& m = *implementation_;
  double reached = m.t;
  if (m.t > m.start_time) m.check(CVodeGetSens(m.memory, &reached, m.directions), "CVodeGetSens");
  std::vector<std::vector<double>> values;
  for (double* from : m.pointers(m.directions)) values.emplace_back(from, from + m.system.size);
  return values;
}

void Cvode::restart(double t, const std::vector<double>& y) {
  Implementation& m = *implementation_;
  m.state = y;
  N_VSetArrayPointer(m.state.data(), m.y);
  m.t = m.start_time = t;
  if (!m.started) {
    m.check(CVodeInit(m.memory, Implementation::derivative, t, m.y), "CVodeInit");
    m.check(CVodeSVtolerances(m.memory, m.tolerances.relative, m.absolute), "CVodeSVtolerances");
    m.check(CVodeSetUserData(m.memory, &m), "CVodeSetUserData");
    m.check(CVodeSetLinearSolver(m.memory, m.linear_solver, m.matrix), "CVodeSetLinearSolver");
    if (m.system.jacobian) m.check(CVodeSetJacFn(m.memory, Implementation::jacobian), "CVodeSetJacFn");
    m.check(CVodeSetMaxNumSteps(m.memory, 2000000), "CVodeSetMaxNumSteps");
    if (m.system.n_roots > 0) {
      m.check(CVodeRootInit(m.memory, static_cast<int>(m.system.n_roots), Implementation::roots),
              "CVodeRootInit");
      m.check(CVodeSetNoInactiveRootWarn(m.memory), "CVodeSetNoInactiveRootWarn");
    }
    if (m.system.n_directions > 0) {
      m.check(CVodeSensInit(m.memory, static_cast<int>(m.system.n_directions), CV_STAGGERED,
                            Implementation::variation, m.directions),
              "CVodeSensInit");
      // Directions are controlled like the state, each by its own size.
      std::vector<double> absolute(m.system.n_directions, m.tolerances.absolute.front());
      m.check(CVodeSensSStolerances(m.memory, m.tolerances.relative, absolute.data()),
              "CVodeSensSStolerances");
      m.check(CVodeSetSensErrCon(m.memory, SUNTRUE), "CVodeSetSensErrCon");
    }
    m.started = true;
  } else {
    m.before_restart = counts();
    m.check(CVodeReInit(m.memory, t, m.y), "CVodeReInit");
    if (m.directions) m.check(CVodeSensReInit(m.memory, CV_STAGGERED, m.directions), "CVodeSensReInit");
  }
}

const std::vector<double>& Cvode::advance(double t_out, double limit) {
  Implementation& m = *implementation_;
  double reached = m.t;
  while (t_out > m.t) {
    m.check(CVodeSetStopTime(m.memory, limit), "CVodeSetStopTime");
    const int code = CVode(m.memory, t_out, m.y, &reached, CV_NORMAL);
    m.t = reached;
    m.check(code, "CVode");
    if (code != CV_ROOT_RETURN) {
      m.t = t_out;
      break;
    }
    std::vector<int> which(m.system.n_roots);
    m.check(CVodeGetRootInfo(m.memory, which.data()), "CVodeGetRootInfo");
    for (std::size_t k = 0; k < which.size(); ++k)
      if (which[k] != 0 && m.system.on_root) m.system.on_root(reached, k, which[k]);
    if (m.directions) m.check(CVodeGetSens(m.memory, &reached, m.directions), "CVodeGetSens");
    m.before_restart = counts();
    m.check(CVodeReInit(m.memory, reached, m.y), "CVodeReInit");
    if (m.directions) m.check(CVodeSensReInit(m.memory, CV_STAGGERED, m.directions), "CVodeSensReInit");
  }
  return m.state;
}

void Cvode::set_largest_step(double h) {
  implementation_->check(CVodeSetMaxStep(implementation_->memory, h), "CVodeSetMaxStep");
}

AdaptiveCounts Cvode::counts() const {
  const Implementation& m = *implementation_;
  AdaptiveCounts c = m.before_restart;
  if (!m.started) return c;
  long value = 0;
  if (CVodeGetNumSteps(m.memory, &value) >= 0) c.steps += value;
  if (CVodeGetNumRhsEvals(m.memory, &value) >= 0) c.evaluations += value;
  if (CVodeGetNumJacEvals(m.memory, &value) >= 0) c.jacobians += value;
  if (CVodeGetNumLinSolvSetups(m.memory, &value) >= 0) c.factorisations += value;
  if (CVodeGetNumErrTestFails(m.memory, &value) >= 0) c.rejected += value;
  return c;
}

}  // namespace wiggers
