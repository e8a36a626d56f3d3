#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <wiggers/cellmodels/catalogue/force_stepper.hpp>
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
  std::unique_ptr<ForceStepper> force;
  std::unique_ptr<CellPopulation> bridges, sliding;  // a step in the wall; one with a velocity that is known
  std::vector<double> states, states_before;         // [node][state], present and at the step's start
  std::vector<double> rest;                          // state whose tension is removed
  std::size_t n_states() const { return plan.model->states.size(); }
};

}  // namespace

struct Activation::Implementation {
  const Partition& partition;
  NodeSpace space;
  RateScheme rate;
  bool stabilise;
  std::vector<Region> regions;
  std::vector<double> strength;  // over the region's own, own nodes
  std::vector<double> tension, stiffness, accepted;
  std::vector<double> calcium, stretch;  // of the present step, local
  double dt = 0;

  Implementation(const Partition& p) : partition(p), space(p.make_nodes(1, true)) {}

  // Refuses lengths (um) and speeds (um/s) that no sarcomere has.
  void require_in_range(const Region& region, std::span<const double> SL,
                        std::span<const double> speed) const {
    const Quantity &lengths = region.plan.model->inputs[1], &range = region.plan.model->inputs[2];
    for (std::size_t k = 0; k < region.nodes.size(); ++k) {
      const auto place = [&] {
        const Point3& p = space.points[region.nodes[k]];
        return fmt::format("({:.1f}, {:.1f}, {:.1f}) mm", 1e3 * p[0], 1e3 * p[1], 1e3 * p[2]);
      };
      if (!(SL[k] > lengths.lower && SL[k] < lengths.upper) || !region.force->holds_at(SL[k]))
        throw NumericalFailure(fmt::format(
            "sarcomere length {:.3g} um at {} (volume tag {}) is beyond what {} describes: the tissue is "
            "stretched too far there. Check pressure, stiffness and the reference configuration",
            SL[k], place(), region.plan.tags.front(), region.plan.model->name));
      if (!(speed[k] >= range.lower && speed[k] <= range.upper))
        throw NumericalFailure(fmt::format(
            "sarcomeres at {} (volume tag {}) change their length by {:.3g} um/s, beyond what any muscle "
            "does: the step is unstable. Keep solver.stabilise.active_stress on, or take a smaller dt_s",
            place(), region.plan.tags.front(), speed[k]));
    }
  }

  // Calcium, lengths and rates of stretch (1/s, own nodes of the region) for the bridges of a region, which
  // then stand at the step's start.
  void drive(Region& region, CellPopulation& bridges, std::span<const double> stretch_rate) {
    const std::size_t n = region.nodes.size();
    const double SL0 = region.force->reference_length_um();
    std::vector<double> Ca(n), SL(n), speed(n);
    for (std::size_t k = 0; k < n; ++k) {
      const int node = region.nodes[k];
      Ca[k] = calcium[node];
      SL[k] = SL0 * stretch[node];
      speed[k] = SL0 * stretch_rate[k];
    }
    require_in_range(region, SL, speed);
    bridges.assign_states(0, region.states_before);
    bridges.set_inputs("Ca", Ca);
    bridges.set_inputs("SL", SL);
    bridges.set_inputs("dSL/dt", speed);
  }

  // Tension above rest, and stiffness, at the nodes of a region.
  void set_forces(const Region& region, std::span<const double> T, std::span<const double> K) {
    const double SL0 = region.force->reference_length_um();
    for (std::size_t k = 0; k < region.nodes.size(); ++k) {
      const int node = region.nodes[k];
      const double scale = region.plan.active ? units::Pa_per_kPa * strength[node] : 0.0;
      const double rest = region.plan.subtract_rest_tension
                              ? region.force->forces(region.rest.data(), SL0 * stretch[node]).tension_kPa
                              : 0.0;
      tension[node] = scale * std::max(0.0, T[k] - rest);
      stiffness[node] = stabilise ? scale * K[k] : 0.0;
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
    const CellModel& model = *region.plan.model;
    region.force = make_force_stepper<double>(model, region.plan.parameters);
    region.rest = steady_force_state(model, region.plan.parameters, region.plan.rest_calcium_uM,
                                     region.force->reference_length_um());
    if (!region.nodes.empty()) {
      const auto bridges = [&](const char* integrator) {
        PopulationSettings settings;
        settings.integrator = integrator;
        return std::make_unique<CellPopulation>(model, region.nodes.size(), settings, region.plan.parameters);
      };
      region.bridges = bridges("in-wall");
      if (rate == RateScheme::implicit) region.sliding = bridges("frozen-midpoint");
    }
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      region.states.insert(region.states.end(), region.rest.begin(), region.rest.end());
    region.states_before = region.states;
    me.regions.push_back(std::move(region));
  }
  me.tension.assign(me.space.n_local, 0.0);
  me.stiffness = me.accepted = me.tension;
  me.calcium = me.tension;
  me.stretch.assign(me.space.n_local, 1.0);
  // The tension of rest: none, where it is removed.
  for (const Region& region : me.regions) {
    const double T =
        region.force->forces(region.rest.data(), region.force->reference_length_um()).tension_kPa;
    me.set_forces(region, std::vector<double>(region.nodes.size(), T),
                  std::vector<double>(region.nodes.size(), 0.0));
  }
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
    std::vector<double> rate, T, K;
    for (Region& region : me.regions) {
      if (region.nodes.empty()) continue;
      region.states_before = region.states;
      rate.assign(region.nodes.size(), 0.0);
      T = K = rate;
      if (me.rate != RateScheme::none)
        for (std::size_t k = 0; k < rate.size(); ++k)
          rate[k] = (stretch[region.nodes[k]] - stretch_before[region.nodes[k]]) / dt_before_s;
      me.drive(region, *region.bridges, rate);
      region.bridges->force_step(dt_s, {RegulationScheme::midpoint, 1, me.rate}, T, K);
      region.bridges->copy_states(0, region.states);
      me.set_forces(region, T, K);
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
      me.drive(region, *region.sliding, rate);
      region.sliding->step(me.dt, 1);
      region.sliding->copy_states(0, region.states);
    }
  });
}

void Activation::require_in_range(std::span<const double> stretch) const {
  const auto& me = *me_;
  collectively(me.partition.communicator(), [&] {
    std::vector<double> SL, speed;
    for (const Region& region : me.regions) {
      const double SL0 = region.force->reference_length_um();
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

namespace {
// Values a node in a saved state: regions may have different force models.
std::size_t most_states(const std::vector<Region>& regions) {
  std::size_t most = 0;
  for (const Region& region : regions) most = std::max(most, region.n_states());
  return most;
}
}  // namespace

void Activation::save(std::vector<double>& out) const {
  const auto& me = *me_;
  const std::size_t most = most_states(me.regions);
  std::vector<double> values(static_cast<std::size_t>(me.space.n_own) * most, 0.0);
  for (const Region& region : me.regions)
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      std::copy_n(&region.states[k * region.n_states()], region.n_states(), &values[region.nodes[k] * most]);
  for (const auto& all : {me.partition.gather(me.space, values.data(), static_cast<int>(most)),
                          me.partition.gather(me.space, me.accepted.data(), 1)})
    out.insert(out.end(), all.begin(), all.end());
}

void Activation::restore(std::span<const double>& in) {
  auto& me = *me_;
  const std::size_t most = most_states(me.regions);
  const auto n = static_cast<std::size_t>(me.space.n_global);
  if (in.size() < n * (most + 1)) throw InputError("the saved state is damaged: it ends early");
  for (Region& region : me.regions) {
    for (std::size_t k = 0; k < region.nodes.size(); ++k)
      std::copy_n(&in[static_cast<std::size_t>(me.space.file_index[region.nodes[k]]) * most],
                  region.n_states(), &region.states[k * region.n_states()]);
    region.states_before = region.states;
  }
  in = in.subspan(n * most);
  Partition::scatter(me.space, in.first(n), me.accepted.data(), 1);
  in = in.subspan(n);
}

}  // namespace wiggers
