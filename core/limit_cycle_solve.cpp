#include <kinsol/kinsol.h>
#include <nvector/nvector_serial.h>
#include <sundials/sundials_context.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <wiggers/core/carried_exception.hpp>
#include <wiggers/core/dense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>

namespace wiggers {

namespace {

using State = BeatMap::State;

// Beats of the accelerated search that bring Newton near enough: from the published CRN start a full first
// step overshoots.
constexpr int beats_before_newton = 10;
// A chord iteration that leaves more than this of the step asks for a new Jacobian.
constexpr double slow_contraction = 0.2;

void run_search(LimitCycleSearch& search, const BeatMap& map, State& state, int most_beats,
                const AfterBeat& after_beat) {
  while (search.running() && search.certificate().beats < most_beats) {
    State proposal;
    try {
      proposal = search.next(state, map.beat(state));
    } catch (const NumericalFailure&) {
      bool recovered = false;
      proposal = search.after_failure(recovered);
      if (!recovered) throw;
    }
    state = proposal;
    map.admit(state);
    if (after_beat) after_beat(search.certificate());
  }
}

Eigen::MatrixXd beat_jacobian(const BeatMap& map, const State& x, const State& image, double relative_step) {
  const auto n = static_cast<Eigen::Index>(x.size());
  std::vector<State> starts;
  std::vector<double> steps;
  for (std::size_t i = 0; i < x.size(); ++i) {
    double h = relative_step * map.scales[i];
    State start = x;
    start[i] += h;
    map.admit(start);
    if (std::abs(start[i] - x[i] - h) > 0.5 * h) {  // clipped at a bound: look the other way
      h = -h;
      start = x;
      start[i] += h;
      map.admit(start);
    }
    starts.push_back(start);
    steps.push_back(h / map.scales[i]);
  }
  std::vector<State> images;
  if (map.beats)
    images = map.beats(starts);
  else
    for (const State& start : starts) images.push_back(map.beat(start));
  Eigen::MatrixXd jacobian(n, n);
  for (Eigen::Index column = 0; column < n; ++column)
    for (Eigen::Index row = 0; row < n; ++row)
      jacobian(row, column) = (images[column][row] - image[row]) / map.scales[row] / steps[column];
  return jacobian;
}

LimitCycleCertificate newton(const BeatMap& map, const LimitCycleSettings& settings, State& state,
                             const AfterBeat& after_beat) {
  LimitCycleSettings start = settings;
  start.method = LimitCycleMethod::anderson;
  LimitCycleSearch search(start, map.scales, map.positive);
  run_search(search, map, state, beats_before_newton, after_beat);
  LimitCycleCertificate certificate = search.certificate();
  if (!search.running()) return certificate;
  certificate.verdict = LimitCycleVerdict::not_converged;

  const std::size_t n = state.size();
  const double relative_step = std::max(1e-5, 10 * std::sqrt(settings.map_noise));
  Eigen::PartialPivLU<Eigen::MatrixXd> lu;
  bool have_jacobian = false;
  double last_step = 0;
  State before;
  while (certificate.beats < settings.max_beats) {
    State image;
    try {
      image = map.beat(state);
    } catch (const NumericalFailure&) {
      // The step went too far: half of it, from where it began.
      if (before.empty()) throw;
      ++certificate.beats;
      for (std::size_t i = 0; i < n; ++i) state[i] = 0.5 * (state[i] + before[i]);
      map.admit(state);
      continue;
    }
    ++certificate.beats;
    before = state;
    Eigen::VectorXd f(static_cast<Eigen::Index>(n));
    for (std::size_t i = 0; i < n; ++i)
      f(static_cast<Eigen::Index>(i)) = (image[i] - state[i]) / map.scales[i];
    certificate.residual = f.lpNorm<Eigen::Infinity>();
    if (have_jacobian && lu.solve(f).lpNorm<Eigen::Infinity>() > slow_contraction * last_step)
      have_jacobian = false;
    if (!have_jacobian) {
      const Eigen::MatrixXd jacobian = beat_jacobian(map, state, image, relative_step);
      certificate.beats += static_cast<int>(n);
      lu.compute(Eigen::MatrixXd::Identity(jacobian.rows(), jacobian.cols()) - jacobian);
      const auto eigenvalues = Eigen::EigenSolver<Eigen::MatrixXd>(jacobian, false).eigenvalues();
      certificate.multiplier = eigenvalues.cwiseAbs().maxCoeff();
      // Where the difference quotients cannot tell a multiplier from one, Newton's step means nothing.
      if ((eigenvalues.array() - 1.0).abs().minCoeff() < 100 * relative_step * relative_step + 1e-9)
        throw NumericalFailure(
            "Newton's method on the beat map met a multiplier of one: the map drifts, or conserves a "
            "quantity that "
            "is not held; there is no isolated cycle");
      have_jacobian = true;
    }
    const Eigen::VectorXd step = lu.solve(f);
    last_step = step.lpNorm<Eigen::Infinity>();
    certificate.distance =
        std::max(last_step, certificate.residual / std::max(1e-6, 1 - certificate.multiplier));
    if (after_beat) after_beat(certificate);
    if (last_step <= settings.distance || certificate.residual <= 10 * settings.map_noise) {
      // The step is exact where r/(1 - multiplier) only bounds; but noise must not pass for a cycle, nor a
      // cycle that beats run away from.
      if (last_step <= settings.distance) certificate.distance = last_step;
      const bool near = certificate.distance <= std::max(settings.distance, largest_noisy_distance);
      certificate.verdict =
          near && certificate.multiplier < 1 ? LimitCycleVerdict::period_1 : LimitCycleVerdict::not_converged;
      state = image;
      return certificate;
    }
    double share = 1;
    for (std::size_t i = 0; i < n && !map.positive.empty(); ++i) {
      const double move = step(static_cast<Eigen::Index>(i)) * map.scales[i];
      if (map.positive[i] && state[i] > 0 && std::abs(move) > 0.5 * state[i])
        share = std::min(share, 0.5 * state[i] / std::abs(move));
    }
    for (std::size_t i = 0; i < n; ++i)
      state[i] += share * step(static_cast<Eigen::Index>(i)) * map.scales[i];
    map.admit(state);
  }
  return certificate;
}

// KINSOL proposes the starts; our search watches the pairs (x, P(x)) and judges.
struct KinsolRun {
  const BeatMap& map;
  LimitCycleSearch search;
  const AfterBeat& after_beat;
  State last;
  CarriedException carried;

  static int evaluate(N_Vector x, N_Vector image, void* user) {
    auto* self = static_cast<KinsolRun*>(user);
    return self->carried.guard([&] {
      const double* from = N_VGetArrayPointer(x);
      State start(from, from + self->map.scales.size());
      self->map.admit(start);
      self->last = self->map.beat(start);
      (void)self->search.next(start, self->last);
      if (self->after_beat) self->after_beat(self->search.certificate());
      std::copy(self->last.begin(), self->last.end(), N_VGetArrayPointer(image));
      return self->search.running() ? 0 : -1;
    });
  }
  static void silent(int, const char*, const char*, char*, void*) {}
};

LimitCycleCertificate kinsol(const BeatMap& map, const LimitCycleSettings& settings, State& state,
                             const AfterBeat& after_beat) {
  const auto n = static_cast<sunindextype>(state.size());
  KinsolRun run{map, LimitCycleSearch(settings, map.scales, map.positive), after_beat, state, {}};
  SUNContext raw_context = nullptr;
  if (SUNContext_Create(nullptr, &raw_context) < 0) throw ResourceError("SUNContext_Create: out of memory");
  const std::unique_ptr<_SUNContext, void (*)(SUNContext)> context(raw_context,
                                                                   [](SUNContext c) { SUNContext_Free(&c); });
  using Vector = std::unique_ptr<_generic_N_Vector, void (*)(N_Vector)>;
  const Vector x(N_VNew_Serial(n, raw_context), N_VDestroy), scale(N_VNew_Serial(n, raw_context), N_VDestroy);
  void* memory = KINCreate(raw_context);
  if (!memory || !x || !scale) throw ResourceError("KINCreate: out of memory");
  for (std::size_t i = 0; i < state.size(); ++i) {
    N_VGetArrayPointer(x.get())[i] = state[i];
    N_VGetArrayPointer(scale.get())[i] = 1.0 / map.scales[i];
  }
  KINSetErrHandlerFn(memory, KinsolRun::silent, nullptr);
  KINSetMAA(memory, std::min<long>(settings.depth, n - 1));
  KINSetDelayAA(memory, settings.plain_beats);
  KINInit(memory, KinsolRun::evaluate, x.get());
  KINSetUserData(memory, &run);
  KINSetNumMaxIters(memory, settings.max_beats + 1);
  KINSetFuncNormTol(memory, 1e-15);  // our certificate ends the iteration
  KINSol(memory, x.get(), KIN_FP, scale.get(), scale.get());
  KINFree(&memory);
  run.carried.rethrow();
  state = run.last;
  LimitCycleCertificate certificate = run.search.certificate();
  // KINSOL gave up, or thinks that it is done where the certificate does not.
  if (run.search.running()) certificate.verdict = LimitCycleVerdict::not_converged;
  return certificate;
}

}  // namespace

LimitCycleCertificate find_limit_cycle(const BeatMap& map, const LimitCycleSettings& settings, State& state,
                                       const AfterBeat& after_beat) {
  if (settings.method == LimitCycleMethod::newton) return newton(map, settings, state, after_beat);
  if (settings.method == LimitCycleMethod::kinsol) return kinsol(map, settings, state, after_beat);
  LimitCycleSearch search(settings, map.scales, map.positive);
  run_search(search, map, state, settings.max_beats, after_beat);
  return search.certificate();
}

}  // namespace wiggers
