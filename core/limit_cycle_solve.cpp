#include <kinsol/kinsol.h>
#include <nvector/nvector_serial.h>
#include <sundials/sundials_context.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>
#include <wiggers/core/carried_exception.hpp>
#include <wiggers/core/dense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle_solve.hpp>
#include <wiggers/core/rhythm.hpp>

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

// A search whose smallest change has not halved for so many rounds gets nowhere.
constexpr int rounds_of_patience = 20;
constexpr int most_rounds = 200;
// Of a search that gets nowhere at a change below this, the map's noise is to blame.
constexpr double noisy_residual = 1e-3;
constexpr double noisy_bend = 0.5;
// A change below so many times the map's stated accuracy that has not halved for so many rounds is noise.
constexpr double noise_per_accuracy = 200;
constexpr double most_noise_per_accuracy = 1e4;
constexpr int rounds_in_noise = 4;
// Of a slow map four differences may miss the slowest direction, and the distance twenty times.
constexpr int differences_of_a_slow_map = 5;
// Plain beats that show the rhythm of a state near a cycle.
constexpr int rhythm_beats = 3 * longest_cycle_beats + 3;
// After a rhythm that proved to be none, the next is watched for so many beats, then for twice as many, ...
constexpr int doubtful_beats = rhythm_beats - longest_cycle_beats;
constexpr int most_doubtful_beats = longest_rhythm_beats;
// A longer rhythm ends the search when it has come back to the distance asked for through so many beats: as
// ions drift one follows another.
constexpr int settled_beats = 4 * longest_rhythm_beats;
// The states within a round may come nearer to each other, or farther apart, by this factor from one round to
// the next; more is another rhythm.
constexpr double largest_change_of_shape = 4;
constexpr int stability_rounds = 6;
// A doubtful cycle's look goes on until the alternation has come back to this share, or for so many rounds.
constexpr double clearly_back = 0.3;
constexpr int longest_look = 200;
// Rounds that leave an unstable cycle, so that what they go to shows.
constexpr int plain_beats_after = 30;
// Following the drift: a jump moves no concentration by more than this share and nothing by more than so
// much of its scale, along the change of the latest rounds, once two of them differ by less than a tenth.
constexpr double drift_share = 0.03;
constexpr double steady_drift = 0.1;
constexpr int most_settling_rounds = 12;
constexpr int drift_jumps = 12;  // before the next try to accelerate
constexpr double longest_drift = 400;

struct RhythmChanged : NumericalFailure {
  RhythmChanged() : NumericalFailure("the rhythm changed") {}
};

class PacedSearch {
 public:
  PacedSearch(const BeatMap& map, const LimitCycleSettings& settings, const AfterBeat& after_beat)
      : map_(map),
        settings_(settings),
        after_beat_(after_beat),
        rhythm_(map.scales, noise_per_accuracy * settings.map_noise) {}

  LimitCycleCertificate run(State& state) {
    rhythm_.see(state);
    int period = pace_until_clear(state, settings_.plain_beats);
    while (period > 0 && spent_ < settings_.max_beats) {
      State found = state;
      const Rhythm before = rhythm_;
      const int spent_before = spent_;
      // An acceleration whose rhythm proves to be none is taken back and pacing goes on from where it was: of
      // several attractors, of many beats too, a search that went on from elsewhere would reach another. As
      // many plain beats as were lost, so that no more than half of all ever are.
      const auto take_back = [&] {
        rhythm_ = before;
        watched_ = std::min(std::max(2 * watched_, doubtful_beats), most_doubtful_beats);
        return pace_until_clear(state, spent_ - spent_before);
      };
      const Outcome outcome = accelerate(found, period);
      if (outcome == Outcome::converged) {
        const int beats = beats_of_cycle(found, period);
        const Stability stability = stability_of(found, beats);
        if (stability == Stability::stable) {
          state = found;
          certificate_.period = beats;
          if (beats > 1) certificate_.verdict = LimitCycleVerdict::period_n;
          certificate_.beats = spent_;
          return certificate_;
        }
        // Its beats went somewhere else: if they alternate, to a cycle twice as long, at first.
        const int next = look(found, rhythm_beats + plain_beats_after * beats);
        const bool doubles = 2 * beats <= longest_cycle_beats && next > 0 && (2 * beats) % next == 0;
        if (next == 2 * beats || (stability == Stability::alternates && doubles)) {
          period = 2 * beats;
          state = found;
        } else {
          period = take_back();
        }
        continue;
      }
      if (outcome == Outcome::rhythm_changed) {
        if (const int again = take_back(); again != period) {
          period = again;
          continue;
        }
      } else {
        // Beats from where the search ended tell whether there is another rhythm, or whether all that is left
        // of the change is the map's noise.
        const LimitCycleCertificate ended = certificate_;
        State nearby = found;
        const int seen = look(nearby, rhythm_beats);
        if (seen == 2 * period) {  // an alternation that came with the drift
          period = seen;
          state = nearby;
          continue;
        }
        if (seen != period) {
          period = take_back();
          continue;
        }
        const double noise = std::min(noisy_residual, most_noise_per_accuracy * settings_.map_noise);
        if (rhythm_.change(period) < noise && rhythm_.bend(period) > noisy_bend) {
          state = found;
          certificate_ = ended;
          certificate_.period = period;
          certificate_.beats = spent_;
          certificate_.noisy = true;
          return certificate_;
        }
        // Along the way of plain beats: from here, if it is farther on that way, else from where they were.
        if (rhythm_.bend(period) < steady_drift) state = nearby;
      }
      follow_drift(state, period);
      rhythm_.forget();
      rhythm_.see(state);
      period = pace_until_clear(state, 2 * period + 3);
    }
    return gave_up();
  }

 private:
  enum class Outcome { converged, stalled, rhythm_changed };
  enum class Stability { stable, alternates, runs_away };

  State one_beat(const State& start) {
    State image = map_.beat(start);
    ++spent_;
    return image;
  }

  void report() {
    certificate_.beats = spent_;
    if (after_beat_) after_beat_(certificate_);
  }

  // At least `plain` beats, then until the rhythm is clear. 0: it never is, or is a longer one; the
  // certificate says what was seen.
  int pace_until_clear(State& state, int plain) {
    int longer = 0, repeated = 0;
    for (int n = 0;; ++n) {
      if (n >= plain)
        if (const int period = rhythm_.period(watched_)) return period;
      const int now = rhythm_.longer_period();
      repeated = now > 0 && now == longer && rhythm_.change(now) <= settings_.distance ? repeated + 1 : 0;
      longer = now;
      if (repeated >= settled_beats || spent_ >= settings_.max_beats) {
        certificate_.reason = describe(rhythm_);
        if (repeated > 0) certificate_.period = longer;
        return 0;
      }
      pace(state);
    }
  }

  // The rhythm of so many beats, at least rhythm_beats, from a state; 0: unclear. The state moves along.
  int look(State& state, int beats) {
    rhythm_.forget();
    rhythm_.see(state);
    for (int n = 0; n < beats && spent_ < settings_.max_beats; ++n) pace(state);
    return rhythm_.period(doubtful_beats);
  }

  void pace(State& state) {
    state = one_beat(state);
    map_.admit(state);
    rhythm_.see(state);
    certificate_.residual = rhythm_.change(1);
    certificate_.distance = certificate_.residual;
    report();
  }

  // The map of a round of beats; throws RhythmChanged where its beats are no longer what they were.
  class Round {
   public:
    Round(PacedSearch& search, int period) : search_(search), period_(period) {}
    State operator()(const State& start) {
      std::vector<State> round = {start};
      State image = search_.one_beat(start);
      while (static_cast<int>(round.size()) < period_) {
        round.push_back(image);
        image = search_.one_beat(image);
      }
      if (period_ == 1) return image;
      double shape = std::numeric_limits<double>::infinity();
      for (int k = 1; k < period_; ++k)
        shape =
            std::min(shape, scaled_distance(round[static_cast<std::size_t>(k)], start, search_.map_.scales));
      const bool other = shape_ > 0 && (shape > largest_change_of_shape * shape_ ||
                                        shape_ > largest_change_of_shape * shape);
      if (other) throw RhythmChanged();
      shape_ = shape;
      return image;
    }

   private:
    PacedSearch& search_;
    int period_;
    double shape_ = 0;  // how far apart the states within the latest round were
  };

  Outcome accelerate(State& state, int period) {
    LimitCycleSettings own = settings_;
    own.plain_beats = 0;
    own.fewest_differences = differences_of_a_slow_map;
    own.known_multiplier = std::max(settings_.known_multiplier, certificate_.multiplier);
    own.max_beats = std::clamp((settings_.max_beats - spent_) / period, 3, most_rounds);
    LimitCycleSearch search(own, map_.scales, map_.positive);
    Round round(*this, period);
    double best = std::numeric_limits<double>::infinity();
    int patience = rounds_of_patience;
    bool failed = false;
    while (search.running() && patience-- > 0) {
      State proposal;
      try {
        proposal = search.next(state, round(state));
      } catch (const NumericalFailure&) {
        bool recovered = false;
        proposal = search.after_failure(recovered);
        if (!recovered) {
          failed = true;
          break;
        }
      }
      state = proposal;
      map_.admit(state);
      certificate_ = search.certificate();
      report();
      if (search.best_residual() < 0.5 * best) {
        best = search.best_residual();
        patience = rounds_of_patience;
      }
      if (search.running() && best < noise_per_accuracy * settings_.map_noise &&
          patience <= rounds_of_patience - rounds_in_noise) {
        // It would wait for a change that is small by chance.
        suspicion_ = search.suspicious_multiplier();
        state = search.best_state();
        map_.admit(state);
        certificate_.residual = search.best_residual();
        certificate_.distance = search.best_residual() / std::max(1e-6, 1 - certificate_.multiplier);
        certificate_.noisy = certificate_.distance > settings_.distance;
        const bool near = certificate_.distance <= std::max(settings_.distance, largest_noisy_distance);
        certificate_.verdict = near ? LimitCycleVerdict::period_1 : LimitCycleVerdict::not_converged;
        return near ? Outcome::converged : Outcome::stalled;
      }
    }
    suspicion_ = search.suspicious_multiplier();
    if (failed) {
      certificate_.verdict = LimitCycleVerdict::not_converged;
      return Outcome::rhythm_changed;
    }
    certificate_ = search.certificate();
    certificate_.beats = spent_;
    if (certificate_.good()) return Outcome::converged;
    state = search.best_state();
    map_.admit(state);
    certificate_.residual = search.best_residual();
    certificate_.verdict = LimitCycleVerdict::not_converged;
    return Outcome::stalled;
  }

  // Where the way to the cycle is long and bent no linear model of the map helps. Plain rounds until their
  // change is steady, then many of them at once along it, as far as concentrations move little; and again.
  void follow_drift(State& state, int period) {
    double reach = drift_share;
    State safe = state;
    for (int jump = 0; jump < drift_jumps && spent_ < settings_.max_beats; ++jump) {
      try {
        Round round(*this, period);
        std::vector<double> change, before;
        double steadiness = 1;
        for (int n = 0; n < most_settling_rounds && steadiness > steady_drift; ++n) {
          const State image = round(state);
          before = std::exchange(change, {});
          double largest = 0, bend = 0;
          for (std::size_t i = 0; i < image.size(); ++i) {
            change.push_back((image[i] - state[i]) / map_.scales[i]);
            largest = std::max(largest, std::abs(change[i]));
            if (!before.empty()) bend = std::max(bend, std::abs(change[i] - before[i]));
          }
          if (!before.empty()) steadiness = bend / largest;
          state = image;
          map_.admit(state);
          certificate_.residual = largest;
          report();
          if (largest <= settings_.distance) return;
        }
        safe = state;
        double rounds = longest_drift;
        for (std::size_t i = 0; i < state.size(); ++i) {
          const double room =
              (!map_.positive.empty() && map_.positive[i] ? reach * std::abs(state[i])
                                                          : reach * std::max(map_.scales[i], 1.0)) /
              map_.scales[i];
          if (std::abs(change[i]) * rounds > room) rounds = room / std::abs(change[i]);
        }
        // Not beyond where the change, which shrinks, is heading.
        double shrinks = 0;
        for (std::size_t i = 0; i < change.size(); ++i)
          if (std::abs(change[i]) == *std::max_element(change.begin(), change.end(), [](double a, double b) {
                return std::abs(a) < std::abs(b);
              }))
            shrinks = before[i] == 0 ? 0 : change[i] / before[i];
        if (shrinks > 0 && shrinks < 1) rounds = std::min(rounds, 0.7 * shrinks / (1 - shrinks));
        if (rounds < 2) continue;
        for (std::size_t i = 0; i < state.size(); ++i) state[i] += rounds * change[i] * map_.scales[i];
        map_.admit(state);
        reach = std::min(drift_share, 1.5 * reach);
      } catch (const NumericalFailure&) {
        state = safe;
        reach *= 0.3;
      }
    }
  }

  // The least number of beats after which a state on a cycle of `period` beats comes back.
  int beats_of_cycle(const State& on_cycle, int period) {
    if (period == 1) return 1;
    const double near = 10 * std::max(certificate_.distance, 1e-6);
    State state = on_cycle;
    for (int beats = 1; beats < period; ++beats) {
      state = one_beat(state);
      if (period % beats == 0 && scaled_distance(state, on_cycle, map_.scales) < near) return beats;
    }
    return period;
  }

  // Whether rounds from beside a cycle come back to it: the search converges to cycles as well that pacing
  // leaves. After rhythms that were none every cycle is looked at, as long as they are watched, and on while
  // it is not clear: what leaves a cycle for irregular beats nearby soon neither grows nor shrinks. Then
  // `state` is where the rounds went.
  Stability stability_of(State& state, int beats) {
    const bool doubtful = watched_ > 0;
    if (suspicion_ < suspicious_multiplier && !doubtful) return Stability::stable;
    const double small = std::clamp(1e4 * settings_.map_noise, 1e-4, 1e-2);
    State beside = state;
    for (std::size_t i = 0; i < beside.size(); ++i)
      beside[i] += (i % 2 == 0 ? small : -small) * std::min(map_.scales[i], std::abs(beside[i]) + 1e-3);
    map_.admit(beside);
    std::vector<State> away;
    const auto size = [](const State& v) {
      double largest = 0;
      for (double x : v) largest = std::max(largest, std::abs(x));
      return largest;
    };
    // The largest alternating part within rounds: slow directions drop out of second differences.
    const auto alternation = [&](int from, int to) {
      double largest = 0;
      for (int n = std::max(from, 1); n < to && n + 1 < static_cast<int>(away.size()); ++n)
        for (std::size_t i = 0; i < beside.size(); ++i)
          largest = std::max(largest, std::abs(away[n + 1][i] - 2 * away[n][i] + away[n - 1][i]));
      return largest;
    };
    bool alternates = false;
    int rounds = std::max(stability_rounds, watched_ / beats);
    for (;; rounds *= 2) {
      while (static_cast<int>(away.size()) < rounds) {
        for (int k = 0; k < beats; ++k) beside = one_beat(beside);
        State difference(beside.size());
        for (std::size_t i = 0; i < beside.size(); ++i)
          difference[i] = (beside[i] - state[i]) / map_.scales[i];
        away.push_back(std::move(difference));
      }
      const int part = doubtful ? rounds / 3 : 1;
      const int first_from = stability_rounds - 4;
      const double first = alternation(first_from, first_from + part);
      const double last = alternation(rounds - 1 - part, rounds - 1);
      // All of it is back: what still alternates is noise.
      double left = 0;
      for (int n = rounds - part; n < rounds; ++n) left = std::max(left, size(away[n]));
      const bool noise =
          last <= 100 * settings_.map_noise || (doubtful && left < clearly_back * size(away.front()));
      alternates = !noise && last >= (doubtful ? clearly_back : 1.0) * first;
      if (!doubtful || noise || last >= first || last < clearly_back * first || rounds >= longest_look) break;
    }
    // In a long look a slow direction may grow at first; on its way back it shrinks with every round.
    bool shrinks = rounds > stability_rounds;
    for (int n = 3 * rounds / 4; n < rounds && shrinks; ++n) shrinks = size(away[n]) < size(away[n - 1]);
    const bool runs_away = size(away.back()) > 3 * size(away.front()) && !shrinks;
    if (!alternates && !runs_away) return Stability::stable;
    state = beside;
    return alternates ? Stability::alternates : Stability::runs_away;
  }

  LimitCycleCertificate gave_up() {
    certificate_.verdict = LimitCycleVerdict::not_converged;
    certificate_.beats = spent_;
    // Of the beats that are left, not of a cycle that was none.
    if (rhythm_.size() > 1) {
      certificate_.residual = rhythm_.change(1);
      certificate_.distance = std::max(certificate_.distance, certificate_.residual);
    }
    return certificate_;
  }

  const BeatMap& map_;
  const LimitCycleSettings& settings_;
  const AfterBeat& after_beat_;
  Rhythm rhythm_;
  LimitCycleCertificate certificate_;
  double suspicion_ = 0;
  int spent_ = 0;
  int watched_ = 0;  // beats through which a rhythm must have held to be believed
};

LimitCycleCertificate search_by_method(const BeatMap& map, const LimitCycleSettings& settings, State& state,
                                       const AfterBeat& after_beat) {
  if (settings.method == LimitCycleMethod::anderson && settings.attractor == Attractor::paced)
    return PacedSearch(map, settings, after_beat).run(state);
  if (settings.method == LimitCycleMethod::newton) return newton(map, settings, state, after_beat);
  if (settings.method == LimitCycleMethod::kinsol) return kinsol(map, settings, state, after_beat);
  LimitCycleSearch search(settings, map.scales, map.positive);
  run_search(search, map, state, settings.max_beats, after_beat);
  return search.certificate();
}

// What plain beats from a state do, in words.
std::string seen_from(const BeatMap& map, State state, int beats) {
  Rhythm rhythm(map.scales);
  rhythm.see(state);
  try {
    for (int beat = 0; beat < beats; ++beat) {
      state = map.beat(state);
      map.admit(state);
      rhythm.see(state);
    }
  } catch (const NumericalFailure& failure) {
    return failure.what();
  }
  return describe(rhythm);
}

}  // namespace

LimitCycleCertificate find_limit_cycle(const BeatMap& map, const LimitCycleSettings& settings, State& state,
                                       const AfterBeat& after_beat) {
  LimitCycleCertificate certificate = search_by_method(map, settings, state, after_beat);
  // As many beats for the words as longer rhythms need, where the search has spent many more.
  const int beats = std::clamp(certificate.beats / 20, rhythm_beats, 2 * longest_rhythm_beats + 1);
  if (!certificate.is_cycle() && certificate.reason.empty())
    certificate.reason = seen_from(map, state, beats);
  return certificate;
}

}  // namespace wiggers
