#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh_geometry.hpp>
#include <wiggers/tissue/reference_cell.hpp>
#include <wiggers/tissue/reference_configuration.hpp>

namespace wiggers {

namespace {

// Displacement of all vertices of the mesh, on every rank.
std::vector<Point3> vertex_displacement(const Mechanics& mechanics) {
  const std::vector<double> flat =
      mechanics.partition().gather_at_vertices(mechanics.nodes(), mechanics.displacement().data(), 3, 0.0);
  std::vector<Point3> d(flat.size() / 3);
  for (std::size_t k = 0; k < d.size(); ++k) d[k] = {flat[3 * k], flat[3 * k + 1], flat[3 * k + 2]};
  return d;
}

bool all_positive(const TetMesh& mesh) {
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (!(cell_volume(mesh, c) > 0)) return false;
  return true;
}

}  // namespace

std::shared_ptr<const TetMesh> recover_reference(const std::shared_ptr<const TetMesh>& image,
                                                 const std::vector<double>& pressures_Pa,
                                                 const MakeMechanics& make, const RecoverySettings& settings,
                                                 RecoveryReport& report,
                                                 const std::function<void(double)>& on_step) {
  std::vector<Point3> X = image->points, good = X, last_good = X;
  double share = 0, step = settings.first_step, last_step = 0;
  std::string failure = "no progress";
  while (share < 1) {
    const double next = std::min(1.0, share + step);
    // The secant through the last two results is the first guess.
    X = good;
    if (last_step > 0)
      for (std::size_t k = 0; k < X.size(); ++k)
        X[k] = good[k] + ((next - share) / last_step) * (good[k] - last_good[k]);
    double omega = 1, before = std::numeric_limits<double>::infinity();
    bool converged = false;
    std::vector<Point3> guess;  // of the displacement, from the last iteration
    std::vector<double> last_residual;
    for (int iteration = 0; iteration < settings.max_iterations; ++iteration) {
      auto mesh = std::make_shared<TetMesh>(*image);
      mesh->points = X;
      if (!all_positive(*mesh)) {
        failure = "a tetrahedron of the unloaded shape turned inside out";
        break;
      }
      auto mechanics = make(mesh);
      std::vector<Point3> d;
      try {
        // From the displacement that the image suggests, one Newton solve mostly does.
        const NodeSpace& space = mechanics->nodes();
        auto& start = mechanics->displacement();
        std::vector<Point3> vertex_guess(X.size());
        for (std::size_t k = 0; k < X.size(); ++k)
          vertex_guess[k] = guess.empty() ? image->points[k] - X[k] : guess[k];
        for (int k = 0; k < space.n_local; ++k)
          if (space.vertex[k] >= 0)
            for (int i = 0; i < 3; ++i)
              start[3 * static_cast<std::size_t>(k) + i] = vertex_guess[space.vertex[k]][i];
        if (mechanics->settings().order == 2) {
          // Edge nodes between their vertices.
          for (std::size_t c = 0; c < mechanics->partition().cells().size(); ++c) {
            const auto nodes = space.nodes_of(static_cast<int>(c));
            for (int e = 0; e < 6; ++e)
              for (int i = 0; i < 3; ++i)
                start[3 * static_cast<std::size_t>(nodes[4 + e]) + i] =
                    0.5 * (start[3 * static_cast<std::size_t>(nodes[tetrahedron_edges[e][0]]) + i] +
                           start[3 * static_cast<std::size_t>(nodes[tetrahedron_edges[e][1]]) + i]);
          }
        }
        const auto loads = [&](double) {
          std::vector<double> p = pressures_Pa;
          for (double& value : p) value *= next;
          return p;
        };
        EquilibriumSettings statics = static_settings(space);
        statics.relative_tolerance = 1e-6;
        statics.first_step = 1;
        statics.smallest_step = 1;
        EquilibriumReport equilibrium;
        try {
          equilibrium = find_equilibrium(*mechanics, loads, statics);
        } catch (const NumericalFailure&) {
          // Otherwise from rest, in steps.
          std::fill(mechanics->displacement().begin(), mechanics->displacement().end(), 0.0);
          statics.first_step = 0.1;
          statics.smallest_step = 1e-3;
          equilibrium = find_equilibrium(
              *mechanics,
              [&](double s) {
                std::vector<double> p = pressures_Pa;
                for (double& value : p) value *= next * s;
                return p;
              },
              statics);
        }
        report.newton_iterations += equilibrium.newton_iterations;
        d = vertex_displacement(*mechanics);
      } catch (const NumericalFailure& error) {
        failure = error.what();
        break;
      }
      ++report.fixed_point_iterations;
      double largest = 0;
      for (std::size_t k = 0; k < X.size(); ++k)
        for (int i = 0; i < 3; ++i)
          largest = std::max(largest, std::abs(image->points[k][i] - X[k][i] - d[k][i]));
      report.residual_m = largest;
      if (largest <= settings.tolerance_m) {
        converged = true;
        break;
      }
      // Aitken: the relaxation that would have been best for the last two residuals. A residual that grows
      // halves it.
      std::vector<double> residual;
      residual.reserve(3 * X.size());
      for (std::size_t k = 0; k < X.size(); ++k)
        for (int i = 0; i < 3; ++i) residual.push_back(image->points[k][i] - X[k][i] - d[k][i]);
      if (!last_residual.empty()) {
        double along = 0, squares = 0;
        for (std::size_t k = 0; k < residual.size(); ++k) {
          const double change = residual[k] - last_residual[k];
          along += last_residual[k] * change;
          squares += change * change;
        }
        omega = std::clamp(-omega * along / squares, 0.1, 2.0);
      }
      if (largest > before) omega = std::max(0.1, std::min(omega, 0.5));
      before = largest;
      last_residual = std::move(residual);
      guess = d;
      for (std::size_t k = 0; k < X.size(); ++k)
        for (int i = 0; i < 3; ++i) {
          const double change = omega * (image->points[k][i] - X[k][i] - d[k][i]);
          X[k][i] += change;
          guess[k][i] -= change;  // the image stays where it is
        }
      failure = fmt::format("the fixed point still moves by {:.2g} mm", 1e3 * largest);
    }
    if (converged) {
      last_good = good;
      good = X;
      last_step = next - share;
      share = next;
      ++report.load_steps;
      step *= 1.5;
      if (on_step) on_step(share);
    } else {
      step *= 0.5;
      if (step < settings.smallest_step)
        throw NumericalFailure(fmt::format(
            "recovery of the reference configuration: stopped at {:.0f} % of the image's load: {}. Lower "
            "image_pressure_mmHg, stiffen the material, or set reference.recover = false",
            100 * share, failure));
    }
  }
  auto mesh = std::make_shared<TetMesh>(*image);
  mesh->points = good;
  report.smallest_volume_ratio = std::numeric_limits<double>::infinity();
  report.smallest_dihedral_deg = 180;
  for (std::size_t c = 0; c < mesh->cells.size(); ++c) {
    report.smallest_volume_ratio =
        std::min(report.smallest_volume_ratio, cell_volume(*mesh, c) / cell_volume(*image, c));
    report.smallest_dihedral_deg =
        std::min(report.smallest_dihedral_deg, smallest_dihedral_angle_deg(*mesh, c));
  }
  return mesh;
}

}  // namespace wiggers
