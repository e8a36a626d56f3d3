// Many cells of one model, stepped together: SIMD lanes in blocks, threads over blocks, no allocation while
// stepping. What tissue and batches are made of; a sheet of two cell types is two populations.
//
//   CellPopulation cells(find_model("ttp06-endo"), 4096);
//   cells.set_input("i_stim", -52);
//   cells.step(0.02, 50);                     // 50 steps of 0.02 ms with the inputs held
//   cells.read_state("V", potentials);
//
// Cells differ by their states, their inputs and, once set_parameters was called, by parameters. Uniform
// parameters cost nothing per cell.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/cellmodels/catalogue/catalogue.hpp>
#include <wiggers/cellmodels/schemes/force_step.hpp>
#include <wiggers/core/instruction_set.hpp>

namespace wiggers {

struct PopulationSettings {
  // rush-larsen | rush-larsen-2 | bdf2-imex (step_under only) for ionic models; frozen-midpoint | in-wall
  // (force_step only) for force models; empty: the model's first
  std::string integrator;
  bool single_precision = false;
  // Spacing of the tables of functions of V, mV; 0: no tables. 0.01 to 1.
  double table_spacing_mV = 0;
  int threads = 1;
  std::string instruction_set = "best";
};

class CellPopulation {
 public:
  // Every cell starts with the model's default state. Refuses settings that the model's kernels do not have.
  CellPopulation(const CellModel& model, std::size_t n_cells, PopulationSettings settings = {},
                 std::vector<double> parameters = {});
  ~CellPopulation();
  CellPopulation(CellPopulation&&) noexcept;

  std::size_t size() const { return n_cells_; }
  const CellModel& model() const { return model_; }
  InstructionSet instruction_set() const { return instruction_set_; }

  // One parameter, cell by cell: shape (size()). Refuses values outside the parameter's range. With tables,
  // parameters of functions of V cannot differ between cells, and are refused.
  void set_parameters(std::string_view name, std::span<const double> values);

  // One input of all cells, in its unit; or cell by cell, shape (size()).
  void set_input(std::string_view name, double value);
  void set_inputs(std::string_view name, std::span<const double> values);

  // All states of one cell, shape (states); or one state of all cells, shape (size()).
  std::vector<double> state_of(std::size_t cell) const;
  void set_state_of(std::size_t cell, std::span<const double> state);
  void read_state(std::string_view name, std::span<double> values) const;
  void write_state(std::string_view name, std::span<const double> values);

  // n_steps steps of h (in the model's time unit) with the inputs held. Afterwards every state is checked:
  // one that left its range throws NumericalFailure with cell, state,
  // value, step and what to try.
  void step(double h, int n_steps = 1);

  // The cells' half of a monodomain step, integrator "bdf2-imex": advances all states but the potential by h
  // under the potential given for the step's end (mV, extrapolated by the caller; shape (size())), and writes
  // the rate of the potential by the cell's own currents, -I_ion/C_m (mV/ms). `first`: there is no history.
  void step_under(std::span<const double> potential_mV, double h, bool first, std::span<double> rate);

  // A force model's step in walls, integrator "in-wall": inputs are calcium in the middle of the step, length
  // at its start and the length's rate of the step before. Writes tension and stiffness (kPa, shape
  // (size())).
  void force_step(double h_s, const ForceScheme& scheme, std::span<double> tension_kPa,
                  std::span<double> stiffness_kPa);

  // All states of all cells, shape (size(), states), now (level 0) or one step earlier (level 1,
  // "bdf2-imex").
  void copy_states(int level, std::span<double> values) const;
  void assign_states(int level, std::span<const double> values);

 private:
  struct Storage;
  template <class Real>
  struct StorageOf;
  const CellModel& model_;
  std::size_t n_cells_;
  PopulationSettings settings_;
  InstructionSet instruction_set_;
  std::vector<double> parameters_;
  std::unique_ptr<Storage> storage_;
};

}  // namespace wiggers
