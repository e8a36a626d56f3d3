#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/catalogue/rdq20_stepper.hpp>
#include <wiggers/cellmodels/population/population.hpp>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/units.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/physics/activation.hpp>

namespace wiggers {

namespace {

struct Region {
  ForceRegion plan;
  std::vector<int> nodes;  // own nodes
  std::unique_ptr<CellPopulation> bridges;
  std::vector<double> states, states_before;  // [node][state], present and at the step's start
  double rest_moment = 0;                     // mu1 at rest, whose tension is removed
};

}  // namespace

struct Activation::Implementation {
  const Partition& partition;
  NodeSpace space;
  RateScheme rate;
  bool stabilise;
  std::vector<Region> regions;
  std::vector<double> strength;  // a_XB over the region's own, own nodes
  std::vector<double> tension, stiffness, accepted;
  std::vector<double> calcium, stretch;  // of the present step, local
  double dt = 0;

  Implementation(const Partition& p) : partition(p), space(p.make_nodes(1, true)) {}

  // Refuses lengths (um) and speeds (um/s) that no sarcomere has.
  void require_in_range(const Region& region, std::span<const double> SL,
                        std::span<const double> speed) const {
    const Quantity& range = Rdq20::inputs[Rdq20::dSL_dt];
    for (std::size_t k = 0; k < region.nodes.size(); ++k) {
      const auto place = [&] {
        const Point3& p = space.points[region.nodes[k]];
        return fmt::format("({:.1f}, {:.1f}, {:.1f}) mm", 1e3 * p[0], 1e3 * p[1], 1e3 * p[2]);
      };
      if (!(SL[k] > 0.5 && SL[k] < 4) ||
          !(Rdq20::dissociation_constant(SL[k], region.plan.parameters.data()) > 0))
        throw NumericalFailure(fmt::format(
            "sarcomere length {:.3g} um at {} (volume tag {}) is beyond what RDQ20 describes: the tissue is "
            "stretched too far there. Check pressure, stiffness and the reference configuration",
            SL[k], place(), region.plan.tags.front()));
      if (!(speed[k] >= range.lower && speed[k] <= range.upper))
        throw NumericalFailure(fmt::format(
            "sarcomeres at {} (volume tag {}) change their length by {:.3g} um/s, beyond what any muscle "
            "does: the step is unstable. Keep solver.stabilise.active_stress on, or take a smaller dt_s",
            place(), region.plan.tags.front(), speed[k]));
    }
  }

  // All bridges of a region from states_before over dt at the given rates of stretch (1/s, own nodes of the
  // region); result in region.states.
  void run(Region& region, std::span<const double> stretch_rate) {
    const std::size_t n = region.nodes.size();
    const double SL0 = region.plan.parameters[Rdq20::SL0];
    std::vector<double> Ca(n), SL(n), speed(n);
    for (std::size_t k = 0; k < n; ++k) {
      const int node = region.nodes[k];
      Ca[k] = calcium[node];
      SL[k] = SL0 * stretch[node];
      speed[k] = SL0 * stretch_rate[k];
    }
    require_in_range(region, SL, speed);
    region.bridges->assign_states(0, region.states_before);
    region.bridges->set_inputs("Ca", Ca);
    region.bridges->set_inputs("SL", SL);
    region.bridges->set_inputs("dSL/dt", speed);
    region.bridges->step(dt, 1);
    region.bridges->copy_states(0, region.states);
  }

  void read_forces(const Region& region, bool mean_stiffness) {
    constexpr std::size_t n_states = Rdq20::states.size();
    for (std::size_t k = 0; k < region.nodes.size(); ++k) {
      const int node = region.nodes[k];
      const double SL = region.plan.parameters[Rdq20::SL0] * stretch[node];
      const double scale = units::Pa_per_kPa * strength[node] * region.plan.parameters[Rdq20::a_XB] *
                           Rdq20::overlap(SL, region.plan.parameters.data());
      const double* y = &region.states[k * n_states];
      const double* before = &region.states_before[k * n_states];
      const double moment =
          y[Rdq20::mu1_P] + y[Rdq20::mu1_N] - (region.plan.subtract_rest_tension ? region.rest_moment : 0);
      tension[node] = region.plan.active ? scale * std::max(0.0, moment) : 0.0;
      double bridges = y[Rdq20::mu0_P] + y[Rdq20::mu0_N];
      if (mean_stiffness) bridges = 0.5 * (bridges + before[Rdq20::mu0_P] + before[Rdq20::mu0_N]);
      stiffness[node] = region.plan.active && stabilise && rate != RateScheme::none ? scale * bridges : 0.0;
    }
  }
};

Activation::Activation(const Partition& partition, const FibreField* fibres, std::vector<ForceRegion> regions,
                       RateScheme rate, bool stabilise)
    : me_(std::make_unique<Implementation>(partition)) {
  auto& me = *me_;
  me.rate = rate;
  me.stabilise = stabilise;
  const TetMesh& mesh = partition.mesh();
  std::vector<int> region_of(me.space.n_own, -1);
  collectively(partition.communicator(), [&] {
    for (std::size_t c = 0; c < partition.cells().size(); ++c) {
      if (!me.space.has(static_cast<int>(c))) continue;
      int mine = -1;
      const int tag = mesh.cell_tags[partition.cells()[c]];
      for (std::size_t r = 0; r < regions.size(); ++r)
        for (int named : regions[r].tags)
          if (named == tag) mine = static_cast<int>(r);
      if (mine < 0)
        throw InputError(
            fmt::format("active force: no cells are named for the volume tag {} of the mesh", tag));
      for (int node : me.space.nodes_of(static_cast<int>(c)))
        if (node < me.space.n_own) region_of[node] = mine;
    }
  });
  me.strength.assign(me.space.n_own, 1.0);
  for (std::size_t r = 0; r < regions.size(); ++r) {
    Region region;
    region.plan = regions[r];
    for (int node = 0; node < me.space.n_own; ++node) {
      if (region_of[node] != static_cast<int>(r)) continue;
      region.nodes.push_back(node);
      const double xi = fibres ? fibres->interventricular[me.space.vertex[node]] : 1.0;
      me.strength[node] = xi + regions[r].right_share * (1 - xi);
    }
    const std::vector<double> rest = rdq20_steady_state(regions[r].parameters, regions[r].rest_calcium_uM,
                                                        regions[r].parameters[Rdq20::SL0]);
    region.rest_moment = rest[Rdq20::mu1_P] + rest[Rdq20::mu1_N];
    if (!region.nodes.empty()) {
      PopulationSettings settings;
      settings.integrator = "frozen-midpoint";
      region.bridges = std::make_unique<CellPopulation>(find_model("rdq20"), region.nodes.size(), settings,
                                                        regions[r].parameters);
    }
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      region.states.insert(region.states.end(), rest.begin(), rest.end());
    region.states_before = region.states;
    me.regions.push_back(std::move(region));
  }
  me.tension.assign(me.space.n_local, 0.0);
  me.stiffness = me.accepted = me.tension;
  me.calcium = me.tension;
  me.stretch.assign(me.space.n_local, 1.0);
  // The tension of rest: none, where it is removed.
  for (const Region& region : me.regions) me.read_forces(region, false);
  me.partition.update_ghosts(me.space, me.tension.data(), 1);
  me.accepted = me.tension;
}

Activation::~Activation() = default;
const NodeSpace& Activation::nodes() const { return me_->space; }
const std::vector<double>& Activation::tension() const { return me_->tension; }
const std::vector<double>& Activation::stiffness() const { return me_->stiffness; }
const std::vector<double>& Activation::accepted_tension() const { return me_->accepted; }

void Activation::begin_step(double dt_s, std::span<const double> calcium_uM, std::span<const double> stretch,
                            std::span<const double> stretch_before, double dt_before_s) {
  auto& me = *me_;
  me.dt = dt_s;
  std::copy(calcium_uM.begin(), calcium_uM.end(), me.calcium.begin());
  std::copy(stretch.begin(), stretch.end(), me.stretch.begin());
  collectively(me.partition.communicator(), [&] {
    std::vector<double> rate;
    for (Region& region : me.regions) {
      if (region.nodes.empty()) continue;
      region.states_before = region.states;
      rate.assign(region.nodes.size(), 0.0);
      if (me.rate == RateScheme::lagged)
        for (std::size_t k = 0; k < rate.size(); ++k)
          rate[k] = (stretch[region.nodes[k]] - stretch_before[region.nodes[k]]) / dt_before_s;
      me.run(region, rate);
      me.read_forces(region, me.rate == RateScheme::implicit);
    }
  });
  me.partition.update_ghosts(me.space, me.tension.data(), 1);
  me.partition.update_ghosts(me.space, me.stiffness.data(), 1);
}

void Activation::accept(std::span<const double> stretch) {
  auto& me = *me_;
  for (int node = 0; node < me.space.n_local; ++node)
    me.accepted[node] = me.tension[node] + me.stiffness[node] * (stretch[node] - me.stretch[node]);
  if (me.rate != RateScheme::implicit) return;
  collectively(me.partition.communicator(), [&] {
    std::vector<double> rate;
    for (Region& region : me.regions) {
      if (region.nodes.empty()) continue;
      rate.resize(region.nodes.size());
      for (std::size_t k = 0; k < rate.size(); ++k)
        rate[k] = (stretch[region.nodes[k]] - me.stretch[region.nodes[k]]) / me.dt;
      me.run(region, rate);
    }
  });
}

void Activation::require_in_range(std::span<const double> stretch) const {
  const auto& me = *me_;
  collectively(me.partition.communicator(), [&] {
    std::vector<double> SL, speed;
    for (const Region& region : me.regions) {
      const double SL0 = region.plan.parameters[Rdq20::SL0];
      SL.clear();
      speed.clear();
      for (int node : region.nodes) {
        SL.push_back(SL0 * stretch[node]);
        // A speed that no bridge feels may be any.
        speed.push_back(me.rate == RateScheme::none ? 0 : SL0 * (stretch[node] - me.stretch[node]) / me.dt);
      }
      me.require_in_range(region, SL, speed);
    }
  });
}

void Activation::reject() {
  for (Region& region : me_->regions) region.states = region.states_before;
}

void Activation::save(std::vector<double>& out) const {
  const auto& me = *me_;
  constexpr std::size_t n_states = Rdq20::states.size();
  std::vector<double> values(static_cast<std::size_t>(me.space.n_own) * n_states, 0.0);
  for (const Region& region : me.regions)
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      std::copy_n(&region.states[k * n_states], n_states, &values[region.nodes[k] * n_states]);
  for (const auto& all : {me.partition.gather(me.space, values.data(), static_cast<int>(n_states)),
                          me.partition.gather(me.space, me.accepted.data(), 1)})
    out.insert(out.end(), all.begin(), all.end());
}

void Activation::restore(std::span<const double>& in) {
  auto& me = *me_;
  constexpr std::size_t n_states = Rdq20::states.size();
  const auto n = static_cast<std::size_t>(me.space.n_global);
  if (in.size() < n * (n_states + 1)) throw InputError("the saved state is damaged: it ends early");
  for (Region& region : me.regions) {
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      std::copy_n(&in[static_cast<std::size_t>(me.space.file_index[region.nodes[k]]) * n_states], n_states,
                  &region.states[k * n_states]);
    region.states_before = region.states;
  }
  in = in.subspan(n * n_states);
  Partition::scatter(me.space, in.first(n), me.accepted.data(), 1);
  in = in.subspan(n);
}

}  // namespace wiggers
