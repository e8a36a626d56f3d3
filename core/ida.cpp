#include <fmt/format.h>
#include <idas/idas.h>
#include <nvector/nvector_serial.h>
#include <sundials/sundials_context.h>
#include <sunlinsol/sunlinsol_dense.h>
#include <sunmatrix/sunmatrix_dense.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/carried_exception.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/ida.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

struct Ida::Implementation {
  DaeSystem system;
  double relative = 0;
  std::vector<double> absolute, state, slope;
  SUNContext context = nullptr;
  N_Vector y = nullptr, dy = nullptr, tolerances = nullptr, id = nullptr;
  SUNMatrix matrix = nullptr;
  SUNLinearSolver linear_solver = nullptr;
  void* memory = nullptr;
  bool started = false;
  double t = 0;
  long steps_before = 0;
  CarriedException carried;
  unsigned evaluations = 0;

  ~Implementation() {
    if (memory) IDAFree(&memory);
    if (linear_solver) SUNLinSolFree(linear_solver);
    if (matrix) SUNMatDestroy(matrix);
    for (N_Vector v : {y, dy, tolerances, id})
      if (v) N_VDestroy(v);
    if (context) SUNContext_Free(&context);
  }
  void check(int code, const char* call) {
    if (code >= 0) return;
    carried.rethrow();
    char* flag = IDAGetReturnFlagName(code);
    const std::string text = flag ? flag : "unknown";
    std::free(flag);
    throw NumericalFailure(
        fmt::format("integration of the differential-algebraic system failed at t = {}: {} ({}). Try a "
                    "looser relative tolerance "
                    "(now {}).",
                    t, text, call, relative));
  }
  static int residual(double t, N_Vector y, N_Vector dy, N_Vector r, void* user) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      if ((++self->evaluations & 15) == 0) check_interrupt();
      double* out = N_VGetArrayPointer(r);
      self->system.residual(t, N_VGetArrayPointer(y), N_VGetArrayPointer(dy), out);
      for (std::size_t i = 0; i < self->system.size; ++i)
        if (!std::isfinite(out[i])) return 1;  // recoverable: the step is cut
      return 0;
    });
  }
  static int roots(double t, N_Vector y, N_Vector, double* values, void* user) {
    auto* self = static_cast<Implementation*>(user);
    return self->carried.guard([&] {
      self->system.roots(t, N_VGetArrayPointer(y), values);
      return 0;
    });
  }
  static void silent(int, const char*, const char*, char*, void*) {}
};

Ida::Ida(DaeSystem system, double relative, std::vector<double> absolute)
    : implementation_(std::make_unique<Implementation>()) {
  Implementation& m = *implementation_;
  m.system = std::move(system);
  m.relative = relative;
  m.absolute = std::move(absolute);
  const auto n = static_cast<sunindextype>(m.system.size);
  m.state.assign(m.system.size, 0.0);
  m.slope.assign(m.system.size, 0.0);
  if (SUNContext_Create(nullptr, &m.context) < 0) throw ResourceError("SUNContext_Create: out of memory");
  m.y = N_VMake_Serial(n, m.state.data(), m.context);
  m.dy = N_VMake_Serial(n, m.slope.data(), m.context);
  m.tolerances = N_VMake_Serial(n, m.absolute.data(), m.context);
  m.id = N_VNew_Serial(n, m.context);
  m.memory = IDACreate(m.context);
  m.matrix = SUNDenseMatrix(n, n, m.context);
  m.linear_solver = SUNLinSol_Dense(m.y, m.matrix, m.context);
  if (!m.y || !m.dy || !m.tolerances || !m.id || !m.memory || !m.matrix || !m.linear_solver)
    throw ResourceError("IDACreate: out of memory");
  for (std::size_t i = 0; i < m.system.size; ++i)
    N_VGetArrayPointer(m.id)[i] = m.system.differential[i] ? 1.0 : 0.0;
  m.check(IDASetErrHandlerFn(m.memory, Implementation::silent, nullptr), "IDASetErrHandlerFn");
}

Ida::~Ida() = default;

void Ida::restart(double t, const std::vector<double>& y, const std::vector<double>& dy, double ahead) {
  Implementation& m = *implementation_;
  std::copy(y.begin(), y.end(), m.state.begin());
  std::copy(dy.begin(), dy.end(), m.slope.begin());
  m.t = t;
  if (!m.started) {
    m.check(IDAInit(m.memory, Implementation::residual, t, m.y, m.dy), "IDAInit");
    m.check(IDASVtolerances(m.memory, m.relative, m.tolerances), "IDASVtolerances");
    m.check(IDASetUserData(m.memory, &m), "IDASetUserData");
    m.check(IDASetId(m.memory, m.id), "IDASetId");
    m.check(IDASetSuppressAlg(m.memory, SUNTRUE), "IDASetSuppressAlg");
    m.check(IDASetLinearSolver(m.memory, m.linear_solver, m.matrix), "IDASetLinearSolver");
    m.check(IDASetMaxNumSteps(m.memory, 2000000), "IDASetMaxNumSteps");
    if (m.system.n_roots > 0)
      m.check(IDARootInit(m.memory, static_cast<int>(m.system.n_roots), Implementation::roots),
              "IDARootInit");
    m.started = true;
  } else {
    m.steps_before = steps();
    m.check(IDAReInit(m.memory, t, m.y, m.dy), "IDAReInit");
  }
  m.check(IDACalcIC(m.memory, IDA_YA_YDP_INIT, ahead), "IDACalcIC");
  m.check(IDAGetConsistentIC(m.memory, m.y, m.dy), "IDAGetConsistentIC");
}

const std::vector<double>& Ida::advance(double t_out, double limit) {
  Implementation& m = *implementation_;
  while (m.t < t_out) {
    m.check(IDASetStopTime(m.memory, limit), "IDASetStopTime");
    double reached = m.t;
    const int code = IDASolve(m.memory, t_out, &reached, m.y, m.dy, IDA_NORMAL);
    m.t = reached;
    m.check(code, "IDASolve");
    if (code != IDA_ROOT_RETURN) {
      m.t = t_out;
      break;
    }
    const std::vector<double> y = m.state, dy = m.slope;
    if (limit - reached > 1e-9) restart(reached, y, dy, std::min(limit, reached + 1e-3));
  }
  return m.state;
}

const std::vector<double>& Ida::derivatives() const { return implementation_->slope; }

long Ida::steps() const {
  long value = 0;
  if (implementation_->started) IDAGetNumSteps(implementation_->memory, &value);
  return implementation_->steps_before + value;
}

}  // namespace wiggers
