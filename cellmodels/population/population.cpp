#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <new>
#include <wiggers/cellmodels/population/kernels.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/threads.hpp>

namespace wiggers {

namespace isa {
struct Baseline;
struct Avx2;
struct Avx512;
}  // namespace isa

template <>
Kernel<double> find_kernel<double>(const KernelKey& key, InstructionSet set) {
#if defined(WIGGERS_X86_KERNELS)
  if (set == InstructionSet::avx512) return kernels::find<isa::Avx512, double>(key);
  if (set == InstructionSet::avx2) return kernels::find<isa::Avx2, double>(key);
#endif
  (void)set;
  return kernels::find<isa::Baseline, double>(key);
}
template <>
Kernel<float> find_kernel<float>(const KernelKey& key, InstructionSet set) {
#if defined(WIGGERS_X86_KERNELS)
  if (set == InstructionSet::avx512) return kernels::find<isa::Avx512, float>(key);
  if (set == InstructionSet::avx2) return kernels::find<isa::Avx2, float>(key);
#endif
  (void)set;
  return kernels::find<isa::Baseline, float>(key);
}

namespace {
// Cache-line aligned numbers.
template <class Real>
struct AlignedAllocator {
  using value_type = Real;
  AlignedAllocator() = default;
  template <class Other>
  AlignedAllocator(const AlignedAllocator<Other>&) {}  // NOLINT: allocators convert
  Real* allocate(std::size_t n) {
    return static_cast<Real*>(::operator new(n * sizeof(Real), std::align_val_t(64)));
  }
  void deallocate(Real* p, std::size_t) { ::operator delete(p, std::align_val_t(64)); }
  bool operator==(const AlignedAllocator&) const { return true; }
};
template <class Real>
using Aligned = std::vector<Real, AlignedAllocator<Real>>;
}  // namespace

struct CellPopulation::Storage {
  virtual ~Storage() = default;
  virtual void set_parameters(std::size_t parameter, std::span<const double> values) = 0;
  virtual void set_input(std::size_t input, double value) = 0;
  virtual void set_inputs(std::size_t input, std::span<const double> values) = 0;
  virtual double get(std::size_t cell, std::size_t state) const = 0;
  virtual void set(std::size_t cell, std::size_t state, double value) = 0;
  virtual void step(double h, int n_steps) = 0;
  virtual void step_under(std::span<const double> potential, double h, bool first,
                          std::span<double> rate) = 0;
  virtual void force_step(double h, const ForceScheme& scheme, std::span<double> tension,
                          std::span<double> stiffness) = 0;
  virtual void copy(int level, std::span<double> values) const = 0;
  virtual void assign(int level, std::span<const double> values) = 0;
};

template <class Real>
struct CellPopulation::StorageOf final : Storage {
  static constexpr std::size_t width = block_lanes<Real>;

  StorageOf(const CellModel& model, std::size_t n_cells, const PopulationSettings& settings,
            InstructionSet set, const std::vector<double>& parameters)
      : model_(model),
        n_cells_(n_cells),
        settings_(settings),
        set_(set),
        parameters_(parameters),
        n_states_(model.states.size()),
        n_inputs_(model.inputs.size()),
        n_blocks_((n_cells + width - 1) / width),
        pool_(settings.threads) {
    states_.resize(n_blocks_ * n_states_ * width);
    const std::vector<double> start = model.default_state();
    // Lanes past the last cell hold a cell, too.
    for (std::size_t cell = 0; cell < n_blocks_ * width; ++cell)
      for (std::size_t i = 0; i < n_states_; ++i)
        states_[index(cell, i, n_states_)] = static_cast<Real>(start[i]);
    for (const Quantity& q : model.inputs) uniform_inputs_.push_back(static_cast<Real>(q.default_value));
    for (double c : model.derived_constants(parameters.data())) constants_.push_back(static_cast<Real>(c));
    for (const Quantity& q : model.states) {
      lower_.push_back(static_cast<Real>(q.lower - slack(q)));
      upper_.push_back(static_cast<Real>(q.upper + slack(q)));
    }
    if (settings.integrator == "bdf2-imex") {
      previous_ = states_;
      rates_.resize(n_blocks_ * width);
    }
    choose_kernel();
  }

  static std::size_t index(std::size_t cell, std::size_t row, std::size_t n_rows) {
    return (cell / width * n_rows + row) * width + cell % width;
  }

  void choose_kernel() {
    kernel_ = find_kernel<Real>(
        {model_.name, settings_.integrator, settings_.table_spacing_mV > 0, !point_constants_.empty()}, set_);
    if (!kernel_)
      throw InputError(fmt::format("{} has no kernel for integrator '{}'{}; it has {}", model_.name,
                                   settings_.integrator, settings_.table_spacing_mV > 0 ? " with tables" : "",
                                   !model_.is_ionic() ? "frozen-midpoint and in-wall, without tables"
                                   : model_.has_voltage_table
                                       ? "rush-larsen, rush-larsen-2 and bdf2-imex, with and without tables"
                                       : "rush-larsen, rush-larsen-2 and bdf2-imex, without tables"));
  }

  void set_parameters(std::size_t parameter, std::span<const double> values) override {
    const std::size_t n_parameters = model_.parameters.size();
    std::vector<double> all(point_parameters_);
    if (all.empty())
      for (std::size_t cell = 0; cell < n_cells_; ++cell)
        all.insert(all.end(), parameters_.begin(), parameters_.end());
    for (std::size_t cell = 0; cell < n_cells_; ++cell) all[cell * n_parameters + parameter] = values[cell];
    if (settings_.table_spacing_mV > 0) {
      const auto uniform = model_.voltage_table_row(-20, 0.01, Decay::exponential, parameters_.data());
      for (std::size_t cell = 0; cell < n_cells_; ++cell)
        if (model_.voltage_table_row(-20, 0.01, Decay::exponential, &all[cell * n_parameters]) != uniform)
          throw InputError(fmt::format(
              "parameter {} enters the tables of functions of V and cannot differ between cells with "
              "tables: set table_spacing_mV = 0, or make one population for each value",
              model_.parameters[parameter].name));
    }
    point_parameters_ = std::move(all);
    const std::size_t n_constants = constants_.size();
    point_constants_.resize(n_blocks_ * n_constants * width);
    for (std::size_t cell = 0; cell < n_blocks_ * width; ++cell) {
      const auto constants =
          model_.derived_constants(&point_parameters_[std::min(cell, n_cells_ - 1) * n_parameters]);
      for (std::size_t k = 0; k < n_constants; ++k)
        point_constants_[index(cell, k, n_constants)] = static_cast<Real>(constants[k]);
    }
    choose_kernel();
  }

  void set_input(std::size_t input, double value) override {
    uniform_inputs_[input] = static_cast<Real>(value);
    for (std::size_t cell = 0; !inputs_.empty() && cell < n_blocks_ * width; ++cell)
      inputs_[index(cell, input, n_inputs_)] = static_cast<Real>(value);
  }
  void set_inputs(std::size_t input, std::span<const double> values) override {
    if (inputs_.empty()) {
      inputs_.resize(n_blocks_ * n_inputs_ * width);
      for (std::size_t cell = 0; cell < n_blocks_ * width; ++cell)
        for (std::size_t k = 0; k < n_inputs_; ++k) inputs_[index(cell, k, n_inputs_)] = uniform_inputs_[k];
    }
    for (std::size_t cell = 0; cell < n_blocks_ * width; ++cell)
      inputs_[index(cell, input, n_inputs_)] = static_cast<Real>(values[std::min(cell, n_cells_ - 1)]);
  }

  double get(std::size_t cell, std::size_t state) const override {
    return static_cast<double>(states_[index(cell, state, n_states_)]);
  }
  void set(std::size_t cell, std::size_t state, double value) override {
    states_[index(cell, state, n_states_)] = static_cast<Real>(value);
  }

  void build_table(double h) {
    const Quantity& q = model_.states[static_cast<std::size_t>(model_.membrane_potential)];
    const double spacing = settings_.table_spacing_mV;
    const auto n_rows = static_cast<long>(std::ceil((q.upper - q.lower) / spacing)) + 1;
    const Decay decay = previous_.empty() ? Decay::exponential : Decay::implicit;
    const std::size_t stride = model_.voltage_table_row(q.lower, h, decay, parameters_.data()).size();
    table_.resize(static_cast<std::size_t>(n_rows) * stride);
    for (long k = 0; k < n_rows; ++k) {
      const auto row =
          model_.voltage_table_row(q.lower + static_cast<double>(k) * spacing, h, decay, parameters_.data());
      for (std::size_t c = 0; c < stride; ++c)
        table_[static_cast<std::size_t>(k) * stride + c] = static_cast<Real>(row[c]);
    }
    view_ = {table_.data(), q.lower, 1 / spacing, n_rows};
    table_step_ = h;
  }

  // Lanes past the last cell are that cell again: they can fail only where it fails, too.
  void fill_spare_lanes(Aligned<Real>& states) {
    for (std::size_t lane = n_cells_; lane < n_blocks_ * width; ++lane)
      for (std::size_t i = 0; i < n_states_; ++i)
        states[index(lane, i, n_states_)] = states[index(n_cells_ - 1, i, n_states_)];
  }

  KernelCall<Real> kernel_call(double decay_step) {
    KernelCall<Real> call;
    if (settings_.table_spacing_mV > 0) {
      if (table_step_ != decay_step) build_table(decay_step);
      call.table = view_;
    }
    call.states = states_.data();
    call.inputs = inputs_.empty() ? nullptr : inputs_.data();
    call.uniform_inputs = uniform_inputs_.data();
    call.constants = constants_.data();
    call.point_constants = point_constants_.empty() ? nullptr : point_constants_.data();
    call.lower = lower_.data();
    call.upper = upper_.data();
    return call;
  }

  void run(const KernelCall<Real>& call, double h) {
    good_.store(true);
    pool_.split(n_blocks_, [&](std::size_t first, std::size_t last) {
      if (!kernel_(call, first, last)) good_.store(false);
    });
    if (!good_.load()) explain(h);
  }

  void step(double h, int n_steps) override {
    fill_spare_lanes(states_);
    KernelCall<Real> call = kernel_call(settings_.integrator == "rush-larsen-2" ? 0.5 * h : h);
    call.h = h;
    call.n_steps = n_steps;
    run(call, h);
  }

  void step_under(std::span<const double> potential, double h, bool first, std::span<double> rate) override {
    const auto row = static_cast<std::size_t>(model_.membrane_potential);
    for (std::size_t cell = 0; cell < n_cells_; ++cell)
      states_[index(cell, row, n_states_)] = static_cast<Real>(potential[cell]);
    fill_spare_lanes(states_);
    fill_spare_lanes(previous_);
    KernelCall<Real> call = kernel_call(first ? h : h / 1.5);
    call.h = h;
    call.n_steps = 1;
    call.previous = previous_.data();
    call.rates = rates_.data();
    call.first = first;
    run(call, h);
    for (std::size_t cell = 0; cell < n_cells_; ++cell) rate[cell] = static_cast<double>(rates_[cell]);
  }

  void force_step(double h, const ForceScheme& scheme, std::span<double> tension,
                  std::span<double> stiffness) override {
    fill_spare_lanes(states_);
    forces_.resize(2 * n_blocks_ * width);
    KernelCall<Real> call = kernel_call(h);
    call.h = h;
    call.scheme = &scheme;
    call.forces = forces_.data();
    run(call, h);
    for (std::size_t cell = 0; cell < n_cells_; ++cell) {
      tension[cell] = static_cast<double>(forces_[index(cell, 0, 2)]);
      stiffness[cell] = static_cast<double>(forces_[index(cell, 1, 2)]);
    }
  }

  void copy(int level, std::span<double> values) const override {
    const auto& from = level == 0 ? states_ : previous_;
    for (std::size_t cell = 0; cell < n_cells_; ++cell)
      for (std::size_t i = 0; i < n_states_; ++i)
        values[cell * n_states_ + i] = static_cast<double>(from[index(cell, i, n_states_)]);
  }
  void assign(int level, std::span<const double> values) override {
    auto& to = level == 0 ? states_ : previous_;
    for (std::size_t cell = 0; cell < n_cells_; ++cell)
      for (std::size_t i = 0; i < n_states_; ++i)
        to[index(cell, i, n_states_)] = static_cast<Real>(values[cell * n_states_ + i]);
  }

  double slack(const Quantity& q) const {
    // BDF2 keeps no bounds: a gate that opens within a step passes its steady value by a little, and comes
    // back. More so where states were interpolated by quadratic shape functions.
    if (settings_.integrator == "bdf2-imex" && q.unit == "1") return 0.5;
    return (sizeof(Real) == 4 ? 1e-4 : 1e-6) * std::max(1.0, std::abs(q.upper));
  }
  [[noreturn]] void explain(double h) const {
    for (std::size_t cell = 0; cell < n_cells_; ++cell)
      for (std::size_t i = 0; i < n_states_; ++i) {
        const Quantity& q = model_.states[i];
        const double value = get(cell, i);
        if (!(value >= q.lower - slack(q) && value <= q.upper + slack(q)))
          throw NumericalFailure(
              fmt::format("{}: cell {}: state {} = {} {} left its physical range {} to {} (integrator {}, "
                          "step {} {}). Try a "
                          "smaller step{}.",
                          model_.name, cell, q.name, value, q.unit, q.lower, q.upper, settings_.integrator, h,
                          model_.time_unit, sizeof(Real) == 4 ? " or double precision" : ""));
      }
    throw NumericalFailure(
        fmt::format("{}: a rate, or a potential on its way out of the tables, left what integrator {} can "
                    "take within a step of {} "
                    "{}. Try a smaller step.",
                    model_.name, settings_.integrator, h, model_.time_unit));
  }

  const CellModel& model_;
  std::size_t n_cells_;
  PopulationSettings settings_;
  InstructionSet set_;
  std::vector<double> parameters_;
  std::size_t n_states_, n_inputs_, n_blocks_;
  ThreadPool pool_;
  Kernel<Real> kernel_ = nullptr;
  Aligned<Real> states_, previous_, rates_, forces_, inputs_, constants_, point_constants_, table_;
  std::vector<Real> uniform_inputs_, lower_, upper_;
  std::vector<double> point_parameters_;
  VoltageTableView<Real> view_;
  double table_step_ = 0;
  std::atomic<bool> good_{true};
};

CellPopulation::CellPopulation(const CellModel& model, std::size_t n_cells, PopulationSettings settings,
                               std::vector<double> parameters)
    : model_(model),
      n_cells_(n_cells),
      settings_(std::move(settings)),
      instruction_set_(instruction_set_by_name(settings_.instruction_set)),
      parameters_(std::move(parameters)) {
  if (n_cells == 0) throw InputError("a population needs at least one cell");
  if (parameters_.empty()) parameters_ = model.parameter_values(model.parameter_sets.front().name);
  if (parameters_.size() != model.parameters.size())
    throw InputError(fmt::format("{} takes {} parameters, {} were given", model.name, model.parameters.size(),
                                 parameters_.size()));
  if (settings_.integrator.empty())
    settings_.integrator = model.is_ionic() ? "rush-larsen" : "frozen-midpoint";
  const double spacing = settings_.table_spacing_mV;
  if (spacing != 0 && !(spacing >= 0.01 && spacing <= 1))
    throw InputError(fmt::format("table_spacing_mV = {} is outside 0.01 to 1 (0: no tables)", spacing));
  if (settings_.threads < 1 || settings_.threads > 1024)
    throw InputError(fmt::format("threads = {} is outside 1 to 1024", settings_.threads));
  if (settings_.single_precision)
    storage_ = std::make_unique<StorageOf<float>>(model, n_cells, settings_, instruction_set_, parameters_);
  else
    storage_ = std::make_unique<StorageOf<double>>(model, n_cells, settings_, instruction_set_, parameters_);
}
CellPopulation::~CellPopulation() = default;
CellPopulation::CellPopulation(CellPopulation&&) noexcept = default;

namespace {
// A state may overshoot its bounds by what the kernels allow: what was read out can be put back.
void check_state(const Quantity& q, double value, const std::string& place) {
  Quantity wide = q;
  const double slack = 1e-4 * std::max(1.0, std::abs(q.upper));
  if (q.unit == "1") wide.lower -= slack;
  wide.upper += slack;
  check_range(wide, value, place);
}
void require_size(std::size_t given, std::size_t wanted, std::string_view name) {
  if (given != wanted) throw InputError(fmt::format("{}: {} values given for {}", name, given, wanted));
}
void require_bdf2(const PopulationSettings& settings) {
  if (settings.integrator != "bdf2-imex")
    throw InputError(fmt::format("integrator '{}' of a population keeps no history: use 'bdf2-imex'",
                                 settings.integrator));
}
}  // namespace

void CellPopulation::set_parameters(std::string_view name, std::span<const double> values) {
  const std::size_t parameter = require_index(model_.parameters, "parameter", name);
  require_size(values.size(), n_cells_, name);
  for (double value : values) check_range(model_.parameters[parameter], value, std::string(model_.name));
  storage_->set_parameters(parameter, values);
}
void CellPopulation::set_input(std::string_view name, double value) {
  const std::size_t input = require_index(model_.inputs, "input", name);
  check_range(model_.inputs[input], value, std::string(model_.name));
  storage_->set_input(input, value);
}
void CellPopulation::set_inputs(std::string_view name, std::span<const double> values) {
  const std::size_t input = require_index(model_.inputs, "input", name);
  require_size(values.size(), n_cells_, name);
  for (double value : values) check_range(model_.inputs[input], value, std::string(model_.name));
  storage_->set_inputs(input, values);
}
std::vector<double> CellPopulation::state_of(std::size_t cell) const {
  if (cell >= n_cells_) throw InputError(fmt::format("cell {} of a population of {}", cell, n_cells_));
  std::vector<double> state(model_.states.size());
  for (std::size_t i = 0; i < state.size(); ++i) state[i] = storage_->get(cell, i);
  return state;
}
void CellPopulation::set_state_of(std::size_t cell, std::span<const double> state) {
  if (cell >= n_cells_) throw InputError(fmt::format("cell {} of a population of {}", cell, n_cells_));
  require_size(state.size(), model_.states.size(), "state");
  for (std::size_t i = 0; i < state.size(); ++i) {
    check_state(model_.states[i], state[i], fmt::format("{}: cell {}", model_.name, cell));
    storage_->set(cell, i, state[i]);
  }
}
void CellPopulation::read_state(std::string_view name, std::span<double> values) const {
  const std::size_t state = require_index(model_.states, "state", name);
  require_size(values.size(), n_cells_, name);
  for (std::size_t cell = 0; cell < n_cells_; ++cell) values[cell] = storage_->get(cell, state);
}
void CellPopulation::write_state(std::string_view name, std::span<const double> values) {
  const std::size_t state = require_index(model_.states, "state", name);
  require_size(values.size(), n_cells_, name);
  for (std::size_t cell = 0; cell < n_cells_; ++cell) {
    check_state(model_.states[state], values[cell], fmt::format("{}: cell {}", model_.name, cell));
    storage_->set(cell, state, values[cell]);
  }
}
void CellPopulation::step(double h, int n_steps) {
  if (settings_.integrator == "bdf2-imex")
    throw InputError("integrator 'bdf2-imex' of a population steps under a given potential: use step_under");
  if (settings_.integrator == "in-wall")
    throw InputError("integrator 'in-wall' of a population gives forces: use force_step");
  if (!(h > 0) || !std::isfinite(h))
    throw InputError(fmt::format("step = {} {} must be positive", h, model_.time_unit));
  if (n_steps < 0) throw InputError(fmt::format("n_steps = {} must not be negative", n_steps));
  storage_->step(h, n_steps);
}
void CellPopulation::step_under(std::span<const double> potential_mV, double h, bool first,
                                std::span<double> rate) {
  require_bdf2(settings_);
  require_size(potential_mV.size(), n_cells_, "potential");
  require_size(rate.size(), n_cells_, "rate");
  if (!(h > 0) || !std::isfinite(h))
    throw InputError(fmt::format("step = {} {} must be positive", h, model_.time_unit));
  storage_->step_under(potential_mV, h, first, rate);
}
void CellPopulation::force_step(double h_s, const ForceScheme& scheme, std::span<double> tension_kPa,
                                std::span<double> stiffness_kPa) {
  if (settings_.integrator != "in-wall")
    throw InputError(fmt::format("integrator '{}' of a population takes no step of a wall: use 'in-wall'",
                                 settings_.integrator));
  require_size(tension_kPa.size(), n_cells_, "tension");
  require_size(stiffness_kPa.size(), n_cells_, "stiffness");
  if (!(h_s > 0) || !std::isfinite(h_s)) throw InputError(fmt::format("step = {} s must be positive", h_s));
  storage_->force_step(h_s, scheme, tension_kPa, stiffness_kPa);
}
void CellPopulation::copy_states(int level, std::span<double> values) const {
  if (level != 0) require_bdf2(settings_);
  require_size(values.size(), n_cells_ * model_.states.size(), "states");
  storage_->copy(level, values);
}
void CellPopulation::assign_states(int level, std::span<const double> values) {
  if (level != 0) require_bdf2(settings_);
  require_size(values.size(), n_cells_ * model_.states.size(), "states");
  storage_->assign(level, values);
}

}  // namespace wiggers
