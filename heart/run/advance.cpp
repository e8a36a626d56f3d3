// A run to its scene's end: beats, the search for their limit cycle, and what is saved when.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/files.hpp>
#include <wiggers/core/stopwatch.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/heart/run/rate_warnings.hpp>
#include <wiggers/heart/run/run.hpp>
#include <wiggers/heart/scene/tissue_services.hpp>

namespace wiggers {

class HeartRun::Advance {
 public:
  Advance(HeartRun& run, Progress::Style style, const std::optional<std::filesystem::path>& result)
      : run_(run), result_(result), cost_before_(run.cost_.heart_s), progress_("heart", style) {
    if (run_.long_beats_)
      steps_per_checkpoint_ =
          std::max(1L, std::lround(run_.scene_.checkpoint_every_ms * units::s_per_ms / run_.scene_.dt_s));
  }

  void to_the_end() {
    // What the start cost, the unloaded shape above all, is not to be lost by an early failure.
    if (run_.long_beats_) {
      if (result_ && !is_special(*result_))
        run_.open_fields(*result_, run_.beat_ != nullptr || run_.cost_.beats > 0);
      save_on_the_way();
    }
    remember();
    while (!finished()) {
      stop_if_asked(run_.cost_.beats);
      if (!run_.beat_) {
        run_.beat_ = std::make_unique<BeatUnderWay>(run_.driver_->begin_beat());
        run_.beat_start_ = run_.driver_->values();
      }
      std::optional<std::vector<double>> plain_start;
      try {
        if (!whole_beat()) break;
      } catch (const Interrupted&) {
        if (run_.long_beats_) throw;
        give_up_beat();
        stop_if_asked(run_.cost_.beats);
        throw;
      } catch (const NumericalFailure& failure) {
        plain_start = after_failure(failure.what());
      }
      go_on_from(plain_start ? *plain_start : after_beat());
      save_between_beats();
    }
    conclude();
  }

 private:
  bool time_is_up() const {
    const double stop_ms = run_.scene_.stop_after_ms;
    return stop_ms > 0 && run_.time_s() * units::ms_per_s >= stop_ms - 1e-6;
  }
  bool finished() const {
    if (time_is_up()) return true;
    return run_.scene_.until_limit_cycle ? !run_.search_->running() : run_.cost_.beats >= run_.scene_.beats;
  }
  void count_time() { run_.cost_.heart_s = cost_before_ + seconds_since(begin_); }

  void stop_if_asked(double beats_done) {
    // Several ranks stop together, or not at all.
    bool stop = tissue_services().any_rank(interrupt_requested());
    try {
      progress_.update(run_.scene_.until_limit_cycle ? -1.0 : beats_done / run_.scene_.beats,
                       fmt::format("beat {}, distance {:.1e}", run_.cost_.beats + (run_.beat_ ? 1 : 0),
                                   run_.certificate_.distance));
    } catch (const Interrupted&) {
      stop = stop || !run_.long_beats_;
    }
    if (!stop) return;
    if (!result_) throw Interrupted("stopped on request; no -o was given, nothing was saved");
    count_time();
    run_.write(*result_, run_.driver_->save());
    throw Interrupted(fmt::format("stopped on request after {:.3f} s; continue with --resume {}",
                                  run_.time_s(), result_->string()));
  }

  // A run that was resumed repeats one that was not, bit for bit: also without a result to write, what goes
  // on is what was saved.
  void save_on_the_way() {
    if (result_)
      run_.checkpoint(*result_);
    else
      run_.driver_->restore(run_.driver_->save());
  }
  void save_between_beats() {
    remember();
    count_time();
    if (run_.long_beats_) {
      if (!result_ || !finished()) save_on_the_way();
    } else if (result_ && !finished() && seconds_since(last_checkpoint_) >= run_.scene_.checkpoint_every_s) {
      run_.write(*result_, run_.driver_->save());
      last_checkpoint_ = Clock::now();
    }
  }
  void remember() {
    if (!run_.long_beats_) good_ = run_.driver_->save();
  }
  void give_up_beat() {
    run_.beat_.reset();
    run_.driver_->restore(good_);
  }

  // The beat under way to its end; false if the run ends within it.
  bool whole_beat() {
    BeatUnderWay& beat = *run_.beat_;
    for (bool done = false; !done;) {
      if (run_.long_beats_) {
        for (const auto& wall : run_.driver_->walls()) wall->write_fields(run_.time_s());
        stop_if_asked(run_.time_s() / run_.scene_.period_s);
      } else {
        check_interrupt();
      }
      if (time_is_up()) break;
      done = run_.driver_->step_beat(beat);
      if (steps_per_checkpoint_ > 0 && !done && beat.steps % steps_per_checkpoint_ == 0) {
        count_time();
        save_on_the_way();
      }
    }
    run_.audit_ = beat.audit;
    if (beat.steps < run_.driver_->steps_per_beat()) return false;
    run_.trace_ = std::move(beat.trace);
    run_.beat_.reset();
    return true;
  }
  std::vector<double> after_beat() {
    const CirculationValues &start = run_.beat_start_, &image = run_.driver_->values();
    ++run_.cost_.beats;
    run_.volume_drift_ = std::max(run_.volume_drift_, std::abs(run_.audit_.blood_volume_change_mL));
    return run_.search_->next({start.begin(), start.end()}, {image.begin(), image.end()});
  }
  // Keeps the last good state; an extrapolated start that failed is given up for a plain one. A beat that was
  // saved on the way is left as it was saved.
  std::vector<double> after_failure(const std::string& reason) {
    const std::string words = failure_text(reason, result_ ? result_->string() : "");
    if (run_.long_beats_)
      throw NumericalFailure(
          fmt::format("at {:.4f} s (beat {}): {}", run_.time_s(), run_.cost_.beats + 1, words));
    give_up_beat();
    bool recovered = false;
    std::vector<double> next = run_.search_->after_failure(recovered);
    if (!recovered) {
      count_time();
      if (result_) run_.write(*result_, run_.driver_->save());
      throw NumericalFailure(fmt::format("beat {}: {}", run_.cost_.beats + 1, words));
    }
    ++run_.cost_.beats;
    return next;
  }
  void go_on_from(const std::vector<double>& proposal) {
    run_.certificate_ = run_.search_->certificate();
    CirculationValues next;
    std::copy(proposal.begin(), proposal.end(), next.begin());
    if (next == run_.driver_->values()) return;
    hold_total_volume(run_.scene_.circulation, next.data(), run_.initial_volume_);
    run_.driver_->move_to(next);
  }

  void conclude() {
    judge();
    if (run_.beat_) {
      // Ended within a beat: its rows are what there is to show.
      run_.trace_ = run_.beat_->trace;
      run_.audit_ = run_.beat_->audit;
    }
    count_time();
    if (run_.long_beats_) {
      for (const auto& wall : run_.driver_->walls()) wall->write_fields(run_.time_s());
      run_.collect_wall_figures();
    }
    if (result_) run_.write(*result_, run_.driver_->save());
    progress_.finish(fmt::format("{} beats, limit cycle: {}, distance {:.1e}", run_.cost_.beats,
                                 run_.certificate_.text(), run_.certificate_.distance));
  }
  void judge() {
    LimitCycleCertificate& certificate = run_.certificate_;
    if (!run_.scene_.until_limit_cycle)
      certificate.verdict = certificate.beats >= 3 && certificate.distance <= run_.scene_.limit_cycle.distance
                                ? LimitCycleVerdict::period_1
                                : LimitCycleVerdict::not_converged;
    run_.complete_ = true;
    if (run_.cost_.beats > 0 || run_.beat_) {
      const PhysicalSense sense = run_.driver_->sense_of(run_.beat_ ? run_.beat_->trace : run_.trace_);
      if (sense.finding()) {
        certificate.verdict = LimitCycleVerdict::unphysical;
        certificate.reason = sense.finding()->text();
      }
    }
    certificate.warnings.clear();
    if (certificate.good() && run_.has_whole_beat())
      certificate.warnings = verdict_warnings(run_.trace_, run_.indexes());
  }

  HeartRun& run_;
  const std::optional<std::filesystem::path>& result_;
  const double cost_before_;
  const Clock::time_point begin_ = Clock::now();
  Clock::time_point last_checkpoint_ = begin_;
  Progress progress_;
  long steps_per_checkpoint_ = 0;
  std::vector<double> good_;  // to go back to
};

void HeartRun::advance(Progress::Style style, const std::optional<std::filesystem::path>& result) {
  Advance(*this, style, result).to_the_end();
}

}  // namespace wiggers
