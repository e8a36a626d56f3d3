#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/body/reference_configuration.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>
#include <wiggers/tissue/mesh/reference_cell.hpp>

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

// Anderson mixing: of the last few iterates the combination whose residual would be least, were the map
// linear. Without it the fixed point stalls on fine meshes near the full load, where single elements are
// soft.
class Mixing {
 public:
  // The change of the iterate, given its residual.
  std::vector<double> next(const std::vector<double>& residual) {
    const double size = norm(residual);
    // A step that made things much worse is not learnt from.
    if (!last_residual_.empty() && size > 2 * last_size_) {
      changes_.clear();
      differences_.clear();
      relaxation_ = 0.5;
    } else if (!last_residual_.empty()) {
      differences_.push_back(minus(residual, last_residual_));
      changes_.push_back(last_change_);
      if (changes_.size() > depth) {
        changes_.erase(changes_.begin());
        differences_.erase(differences_.begin());
      }
      relaxation_ = 1;
    }
    std::vector<double> change = residual;
    for (double& value : change) value *= relaxation_;
    if (const auto m = static_cast<Eigen::Index>(differences_.size()); m > 0) {
      const auto n = static_cast<Eigen::Index>(residual.size());
      Eigen::MatrixXd R(n, m);
      for (Eigen::Index k = 0; k < m; ++k)
        R.col(k) = Eigen::Map<const Eigen::VectorXd>(differences_[k].data(), n);
      // Nearly dependent differences count as one.
      Eigen::ColPivHouseholderQR<Eigen::MatrixXd> factors(R);
      factors.setThreshold(1e-8);
      const Eigen::VectorXd share = factors.solve(Eigen::Map<const Eigen::VectorXd>(residual.data(), n));
      for (Eigen::Index k = 0; k < m; ++k)
        for (Eigen::Index i = 0; i < n; ++i)
          change[i] -= share(k) * (changes_[k][i] + relaxation_ * differences_[k][i]);
    }
    last_residual_ = residual;
    last_change_ = change;
    last_size_ = size;
    return change;
  }

 private:
  static constexpr std::size_t depth = 6;
  static double norm(const std::vector<double>& v) {
    double sum = 0;
    for (double value : v) sum += value * value;
    return std::sqrt(sum);
  }
  static std::vector<double> minus(const std::vector<double>& a, const std::vector<double>& b) {
    std::vector<double> c(a);
    for (std::size_t k = 0; k < c.size(); ++k) c[k] -= b[k];
    return c;
  }

  std::vector<std::vector<double>> changes_, differences_;  // of iterate and residual
  std::vector<double> last_residual_, last_change_;
  double last_size_ = 0, relaxation_ = 1;
};

double mean_edge(const TetMesh& mesh) {
  double sum = 0;
  for (const auto& cell : mesh.cells)
    for (const auto& edge : tetrahedron_edges) {
      const Point3 along = mesh.points[cell[edge[1]]] - mesh.points[cell[edge[0]]];
      sum += std::sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    }
  return sum / (6.0 * static_cast<double>(mesh.cells.size()));
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
  const double good_enough_m = settings.good_enough * mean_edge(*image);
  while (share < 1) {
    const double next = std::min(1.0, share + step);
    // The secant through the last two results is the first guess.
    X = good;
    if (last_step > 0)
      for (std::size_t k = 0; k < X.size(); ++k)
        X[k] = good[k] + ((next - share) / last_step) * (good[k] - last_good[k]);
    bool converged = false;
    std::vector<Point3> guess;  // of the displacement, from the last iteration
    Mixing mixing;
    double best = std::numeric_limits<double>::infinity(), halved = best;
    std::vector<Point3> best_X;
    int since_halved = 0;
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
      ++since_halved;
      if (largest < 0.5 * halved) {
        halved = largest;
        since_halved = 0;
      }
      if (largest < best) {
        best = largest;
        best_X = X;
      }
      const bool last = iteration + 1 == settings.max_iterations;
      const bool stalls = next < 1 || since_halved >= settings.patience || last;
      if (best <= settings.aim_m || (best <= good_enough_m && stalls)) {
        X = best_X;
        report.residual_m = best;
        converged = true;
        break;
      }
      std::vector<double> residual;
      residual.reserve(3 * X.size());
      for (std::size_t k = 0; k < X.size(); ++k)
        for (int i = 0; i < 3; ++i) residual.push_back(image->points[k][i] - X[k][i] - d[k][i]);
      const std::vector<double> change = mixing.next(residual);
      guess = d;
      for (std::size_t k = 0; k < X.size(); ++k)
        for (int i = 0; i < 3; ++i) {
          X[k][i] += change[3 * k + i];
          guess[k][i] -= change[3 * k + i];  // the image stays where it is
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
            "the pressures of [reference], image_pressure_..._mmHg, stiffen the material, or set "
            "reference.recover = false",
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
