// Kernels that step blocks of cells with SIMD vectors, compiled once for each instruction set and found here
// by name. CellPopulation (population.hpp) is their user; everybody else uses that.
//
// States stand in blocks of one cache line: states[block][state][lane], 8 lanes in double, 16 in single
// precision, whatever the vector width of the instruction set.
#pragma once

#include <cstddef>
#include <string_view>
#include <wiggers/cellmodels/schemes/force_step.hpp>
#include <wiggers/cellmodels/schemes/voltage_table.hpp>
#include <wiggers/core/instruction_set.hpp>

namespace wiggers {

template <class Real>
inline constexpr std::size_t block_lanes = 64 / sizeof(Real);

template <class Real>
struct KernelCall {
  Real* states = nullptr;
  const Real* inputs = nullptr;           // [block][input][lane], or null: the uniform ones
  const Real* uniform_inputs = nullptr;   // [input]
  const Real* constants = nullptr;        // the model's derived constants, uniform
  const Real* point_constants = nullptr;  // [block][constant][lane], or null: the uniform ones
  // Of steps h (rush-larsen), h/2 (rush-larsen-2) or h/a0 (bdf2-imex: a0 = 3/2, first 1); no rows: none.
  VoltageTableView<Real> table;
  const Real* lower = nullptr;  // [state]: the range outside which a state is refused
  const Real* upper = nullptr;
  double h = 0;
  int n_steps = 0;
  // Integrator "bdf2-imex": one step under a given potential, which stands in the row of the membrane
  // potential.
  Real* previous = nullptr;  // [block][state][lane]: the states one step earlier
  Real* rates = nullptr;     // [block][lane]: dV/dt of the cell's own currents, written
  bool first = false;        // no history yet: BDF1
  // Integrator "in-wall" of force models: one step; the length's rate is that of the step before.
  const ForceScheme* scheme = nullptr;
  Real* forces = nullptr;  // [block][tension, stiffness][lane], kPa, written
};

// Steps the blocks [first, last); false if in the end a state is outside its range or no number, or if on the
// way a potential left the table.
template <class Real>
using Kernel = bool (*)(const KernelCall<Real>&, std::size_t first, std::size_t last);

struct KernelKey {
  std::string_view model;  // a name of the catalogue
  std::string_view
      integrator;  // rush-larsen | rush-larsen-2 | bdf2-imex; of force models frozen-midpoint | in-wall
  bool tabulated = false;
  bool per_point = false;
};

// Null if there is no such kernel.
template <class Real>
Kernel<Real> find_kernel(const KernelKey& key, InstructionSet set);

namespace kernels {
template <class Isa, class Real>
Kernel<Real> find(const KernelKey& key);
}

}  // namespace wiggers
