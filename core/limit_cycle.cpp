#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <wiggers/core/dense.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/limit_cycle.hpp>
#include <wiggers/core/saved_numbers.hpp>

namespace wiggers {

namespace {

// After a jump along the slow directions the fast ones are out of step, and the change over a beat grows
// although the state is nearer to the cycle (CRN: thirtyfold). Only a growth beyond that means that the jump
// went astray.
constexpr double largest_growth = 1000;

constexpr double longest_jump = 1e4;
constexpr double unknown_multiplier = 0.999;
// A jump that went astray is followed by shorter ones, which grow again.
constexpr double shorter = 0.3, longer = 1.5;

// Plain beats whose change differs by less than this, relative to it, move along one line without slowing
// down.
constexpr double steady_drift = 1e-4;

double max_abs(const std::vector<double>& v) {
  double largest = 0;
  for (double entry : v) largest = std::max(largest, std::abs(entry));
  return largest;
}

}  // namespace

LimitCycleMethod limit_cycle_method(std::string_view name) {
  if (name == "anderson") return LimitCycleMethod::anderson;
  if (name == "newton") return LimitCycleMethod::newton;
  if (name == "kinsol") return LimitCycleMethod::kinsol;
  if (name == "pacing") return LimitCycleMethod::pacing;
  refuse_unknown("limit-cycle method", name,
                 std::vector<std::string>{"anderson", "newton", "kinsol", "pacing"});
}

Attractor attractor_named(std::string_view name) {
  if (name == "paced") return Attractor::paced;
  if (name == "any") return Attractor::any;
  refuse_unknown("attractor", name, std::vector<std::string>{"paced", "any"});
}

std::string to_string(LimitCycleVerdict verdict, int period) {
  switch (verdict) {
    case LimitCycleVerdict::running:
      return "running";
    case LimitCycleVerdict::period_1:
      return "period-1";
    case LimitCycleVerdict::period_n:
      return "period-" + std::to_string(period);
    case LimitCycleVerdict::drifting:
      return "drifting";
    case LimitCycleVerdict::not_converged:
      return "not-converged";
    case LimitCycleVerdict::unphysical:
      return "unphysical";
  }
  return "not-converged";
}

namespace {
constexpr std::array plain_verdicts = {LimitCycleVerdict::running, LimitCycleVerdict::period_1,
                                       LimitCycleVerdict::drifting, LimitCycleVerdict::not_converged,
                                       LimitCycleVerdict::unphysical};
}

std::pair<LimitCycleVerdict, int> limit_cycle_verdict(std::string_view text) {
  std::vector<std::string> known;
  for (const LimitCycleVerdict verdict : plain_verdicts) {
    known.push_back(to_string(verdict));
    if (known.back() == text) return {verdict, 1};
  }
  for (int n = 2; n <= longest_cycle_beats; ++n) {
    known.push_back(to_string(LimitCycleVerdict::period_n, n));
    if (known.back() == text) return {LimitCycleVerdict::period_n, n};
  }
  refuse_unknown("verdict of a limit-cycle search", text, known);
}

std::string LimitCycleCertificate::text_with_warnings() const {
  std::string all = text();
  for (std::size_t k = 0; k < warnings.size(); ++k)
    all += (k == 0 ? ", with warnings: " : "; ") + warnings[k];
  return all;
}

double saved_verdict(const LimitCycleCertificate& c) {
  const auto plain = std::find(plain_verdicts.begin(), plain_verdicts.end(), c.verdict);
  return plain == plain_verdicts.end() ? static_cast<double>(plain_verdicts.size()) + c.period
                                       : static_cast<double>(plain - plain_verdicts.begin());
}

void take_verdict(SavedNumbers& in, LimitCycleCertificate& c) {
  const long n = static_cast<long>(plain_verdicts.size());
  const long number = in.count(n + longest_cycle_beats);
  c.verdict = number < n ? plain_verdicts[static_cast<std::size_t>(number)] : LimitCycleVerdict::period_n;
  c.period = number < n ? 1 : static_cast<int>(number - n);
}

std::string limit_cycle_failure(const LimitCycleCertificate& c) {
  if (c.verdict == LimitCycleVerdict::unphysical) return c.reason;
  const bool may_go_on = c.verdict == LimitCycleVerdict::not_converged;
  if (may_go_on && c.period > longest_cycle_beats)
    return fmt::format("there is no limit cycle of up to {} beats where pacing goes: {} after {} beats. {}",
                       longest_cycle_beats, c.text(), c.beats, c.reason);
  return fmt::format(
      "{}: {} after {} beats, distance {:.2g}.{}{}{}",
      c.verdict == LimitCycleVerdict::period_n ? "no limit cycle of one beat"
                                               : "the limit cycle was not reached",
      c.text(), c.beats, c.distance, c.reason.empty() ? "" : " ", c.reason,
      c.noisy ? " The integrator's noise bounds the distance: a tighter tolerance or a smaller step helps."
      : may_go_on ? " Allow more beats."
                  : "");
}

LimitCycleSearch::LimitCycleSearch(LimitCycleSettings settings, std::vector<double> scales,
                                   std::vector<bool> positive)
    : settings_(settings),
      scales_(std::move(scales)),
      positive_(std::move(positive)),
      plain_left_(settings.plain_beats) {
  certificate_.multiplier = settings.known_multiplier;
}

std::vector<double> LimitCycleSearch::unscaled(const std::vector<double>& x,
                                               const std::vector<double>& f) const {
  std::vector<double> result(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) result[i] = (x[i] + f[i]) * scales_[i];
  return result;
}

std::vector<double> LimitCycleSearch::next(const std::vector<double>& x, const std::vector<double>& image) {
  const std::size_t n = x.size();
  Pair now{std::vector<double>(n), std::vector<double>(n)};
  for (std::size_t i = 0; i < n; ++i) {
    now.x[i] = x[i] / scales_[i];
    now.f[i] = (image[i] - x[i]) / scales_[i];
    if (!std::isfinite(now.f[i]))
      throw NumericalFailure("the beat map returned a value that is not finite; the last start was kept");
  }
  ++certificate_.beats;
  const double residual = max_abs(now.f);
  certificate_.residual = residual;
  const bool lost = accelerated_ && residual > largest_growth * best_residual_;
  if (best_.x.empty() || residual < best_residual_) {
    best_ = now;
    best_residual_ = residual;
  }
  if (plain_left_ > 0) --plain_left_;
  if (plain_left_ == 0 || settings_.method == LimitCycleMethod::pacing) history_.push_back(now);
  if (static_cast<int>(history_.size()) > settings_.depth + 1) history_.erase(history_.begin());

  // Least-squares model of P from the differences of the remembered beats.
  const double noise = 10 * settings_.map_noise;
  double latest_difference = 0;
  const int m = static_cast<int>(history_.size()) - 1;
  double step_to_fixed_point = residual;
  std::vector<double> correction;
  if (m >= 1) {
    Eigen::MatrixXd dx(n, m), df(n, m);
    for (int k = 0; k < m; ++k) {
      double length = 0;
      for (std::size_t i = 0; i < n; ++i) {
        dx(i, k) = history_[k + 1].x[i] - history_[k].x[i];
        df(i, k) = history_[k + 1].f[i] - history_[k].f[i];
        length += df(i, k) * df(i, k);
      }
      latest_difference = dx.col(k).lpNorm<Eigen::Infinity>();
      // Columns of one length: the latest, smallest differences count as much as the first.
      if (length > 0) {
        dx.col(k) /= std::sqrt(length);
        df.col(k) /= std::sqrt(length);
      }
    }
    const Eigen::Map<const Eigen::VectorXd> f(now.f.data(), static_cast<Eigen::Index>(n));
    const Eigen::JacobiSVD<Eigen::MatrixXd> svd(df, Eigen::ComputeThinU | Eigen::ComputeThinV);
    const auto& sigma = svd.singularValues();
    Eigen::VectorXd gamma = Eigen::VectorXd::Zero(m);
    for (int k = 0; k < sigma.size(); ++k)
      if (sigma(k) > 1e-7 * sigma(0) && sigma(k) > 0)
        gamma += svd.matrixV().col(k) * (svd.matrixU().col(k).dot(f) / sigma(k));
    const Eigen::VectorXd step = f - (dx + df) * gamma;
    if (step.allFinite()) {
      correction.assign(step.data(), step.data() + n);
      step_to_fixed_point = max_abs(correction);
    }
    // Leading multiplier: eigenvalues of P's model in the span of dx, P'(dx) = dx + df.
    const Eigen::JacobiSVD<Eigen::MatrixXd> span(dx, Eigen::ComputeThinU | Eigen::ComputeThinV);
    const auto& lengths = span.singularValues();
    int rank = 0;
    while (rank < lengths.size() && lengths(rank) > 1e-7 * lengths(0)) ++rank;
    if (rank > 0) {
      const Eigen::MatrixXd u = span.matrixU().leftCols(rank);
      const Eigen::MatrixXd v = span.matrixV().leftCols(rank);
      const Eigen::MatrixXd reduced =
          u.transpose() * (dx + df) * v * lengths.head(rank).cwiseInverse().asDiagonal();
      if (reduced.allFinite()) {
        const auto eigenvalues = Eigen::EigenSolver<Eigen::MatrixXd>(reduced, false).eigenvalues();
        double multiplier = 0;
        for (int k = 0; k < eigenvalues.size(); ++k)
          if (std::abs(eigenvalues(k)) < 1.0) multiplier = std::max(multiplier, std::abs(eigenvalues(k)));
        // Differences near the map's own noise say nothing about its slope: keep the last sound estimate.
        if (latest_difference > 1e3 * noise) {
          // The pairs of a short way see only some directions: what is known of the slowest counts on.
          certificate_.multiplier = std::max(settings_.known_multiplier, multiplier);
          double suspicious = 0;
          for (int k = 0; k < eigenvalues.size(); ++k)
            if (eigenvalues(k).real() < 0 || std::abs(eigenvalues(k)) >= 1)
              suspicious = std::max(suspicious, std::abs(eigenvalues(k)));
          // One that is the map's is in the next estimate as well; noise is not.
          suspicious_multiplier_ = std::min(suspicious, latest_suspicious_);
          latest_suspicious_ = suspicious;
        }
      }
    }
  }
  judge(step_to_fixed_point);
  if (!running() || settings_.method == LimitCycleMethod::pacing) {
    accelerated_ = false;
    return image;
  }
  if (lost) {
    accelerated_ = jumped_ = false;
    reach_ *= shorter;
    return unscaled(best_.x, best_.f);
  }
  accelerated_ = plain_left_ == 0 && !correction.empty();
  if (!accelerated_) return image;
  if (relaxing_ > 0) {
    --relaxing_;
    accelerated_ = false;
    return image;
  }
  relaxing_ = settings_.relaxing_beats;
  jumped_ = true;
  // A jump longer than this times the change over a beat would mean a multiplier above 0.9999: rounding, more
  // likely.
  double share = std::min(reach_, longest_jump * residual / step_to_fixed_point);
  reach_ = std::min(1.0, longer * reach_);
  for (std::size_t i = 0; i < n && !positive_.empty(); ++i) {
    if (!positive_[i] || now.x[i] <= 0) continue;
    if (correction[i] > now.x[i]) share = std::min(share, now.x[i] / correction[i]);
    if (correction[i] < -0.5 * now.x[i]) share = std::min(share, -0.5 * now.x[i] / correction[i]);
  }
  for (double& c : correction) c *= share;
  return unscaled(now.x, correction);
}

std::vector<double> LimitCycleSearch::after_failure(bool& recovered) {
  recovered = jumped_ && !best_.x.empty() && certificate_.beats < settings_.max_beats;
  if (!recovered) return {};
  ++certificate_.beats;
  accelerated_ = jumped_ = false;
  relaxing_ = 0;
  reach_ *= shorter;
  return unscaled(best_.x, best_.f);
}

void LimitCycleSearch::judge(double step_to_fixed_point) {
  LimitCycleCertificate& c = certificate_;
  const double r = c.residual;
  const double noise = 10 * settings_.map_noise;
  // Two independent estimates of the distance: the change over 1 - lambda, and the model's own step. Before
  // anything is known of lambda it may be that of a slow cell.
  const bool known = settings_.known_multiplier > 0 ||
                     (c.multiplier > 0 && static_cast<int>(history_.size()) > settings_.fewest_differences);
  const double slowest = known ? c.multiplier : std::max(c.multiplier, unknown_multiplier);
  c.distance = std::max(r / std::max(1e-6, 1 - slowest), step_to_fixed_point);
  if (c.beats >= 3 && (c.distance <= settings_.distance || r <= noise)) {
    // The map's own noise ends the search; what is left of the distance must still be small to call it a
    // cycle.
    const bool near = c.distance <= std::max(settings_.distance, largest_noisy_distance);
    c.verdict = near ? LimitCycleVerdict::period_1 : LimitCycleVerdict::not_converged;
    c.noisy = c.distance > settings_.distance;
    return;
  }
  if (c.beats < settings_.max_beats) return;
  // Alternans: x and P(P(x)) agree although x and P(x) do not.
  c.verdict = LimitCycleVerdict::not_converged;
  if (history_.size() >= 3 && !accelerated_) {
    const Pair& last = history_.back();
    const Pair& before = history_[history_.size() - 2];
    double two_beats = 0, difference = 0;
    for (std::size_t i = 0; i < last.f.size(); ++i)
      two_beats = std::max(two_beats, std::abs(last.f[i] + before.f[i]));
    for (std::size_t i = 0; i < last.f.size(); ++i)
      difference = std::max(difference, std::abs(last.f[i] - before.f[i]));
    if (two_beats <= settings_.distance && two_beats < 0.01 * r) {
      c.verdict = LimitCycleVerdict::period_n;
      c.period = 2;
      c.distance = c.residual = two_beats;
    }
    if (difference < steady_drift * r) c.verdict = LimitCycleVerdict::drifting;
  }
}

namespace {
void put(std::vector<double>& out, const std::vector<double>& values) {
  out.push_back(static_cast<double>(values.size()));
  out.insert(out.end(), values.begin(), values.end());
}
}  // namespace

std::vector<double> LimitCycleSearch::save() const {
  std::vector<double> out = {saved_verdict(certificate_),
                             certificate_.distance,
                             certificate_.residual,
                             certificate_.multiplier,
                             static_cast<double>(certificate_.beats),
                             best_residual_,
                             accelerated_ ? 1.0 : 0.0,
                             static_cast<double>(plain_left_),
                             static_cast<double>(relaxing_),
                             jumped_ ? 1.0 : 0.0,
                             reach_,
                             static_cast<double>(history_.size())};
  for (const Pair& pair : history_) {
    put(out, pair.x);
    put(out, pair.f);
  }
  put(out, best_.x);
  put(out, best_.f);
  return out;
}

void LimitCycleSearch::restore(SavedNumbers saved) {
  constexpr long most = std::numeric_limits<int>::max();
  const std::size_t n = scales_.size();
  const auto take = [&](bool may_be_empty) {
    const long size = saved.count(static_cast<long>(n));
    if (size != static_cast<long>(n) && !(may_be_empty && size == 0))
      saved.refuse(fmt::format("a state of {} numbers, {} are wanted", size, n));
    return saved.numbers(static_cast<std::size_t>(size));
  };
  LimitCycleCertificate c;
  take_verdict(saved, c);
  c.distance = saved.not_negative();
  c.residual = saved.not_negative();
  c.multiplier = saved.not_negative();
  c.beats = static_cast<int>(saved.count(most));
  best_residual_ = saved.not_negative();
  accelerated_ = saved.flag();
  plain_left_ = static_cast<int>(saved.count(most));
  relaxing_ = static_cast<int>(saved.count(most));
  jumped_ = saved.flag();
  reach_ = saved.not_negative();
  const long n_pairs = saved.count(settings_.depth + 1);
  history_.clear();
  for (long k = 0; k < n_pairs; ++k) {
    Pair pair;
    pair.x = take(false);
    pair.f = take(false);
    history_.push_back(std::move(pair));
  }
  best_.x = take(true);
  best_.f = take(true);
  if (best_.x.size() != best_.f.size()) saved.refuse("the best state and its change differ in length");
  saved.finish();
  certificate_ = c;
}

}  // namespace wiggers
