#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/reference_cell.hpp>
#include <wiggers/tissue/parallel/collective.hpp>
#include <wiggers/tissue/physics/element.hpp>
#include <wiggers/tissue/physics/mechanics.hpp>

namespace wiggers {

namespace {

constexpr int most_nodes = 10;
constexpr double fixed_row_stiffness = 100;  // N/m; any number of the size of the others does

// The gradients of the barycentric coordinates at a quadrature point, in its fibre frame, and its volume.
struct Point {
  double gradient[4][3];
  double volume;
};

// Number of the edge between two corners of a tetrahedron.
int edge_between(int a, int b) {
  for (int e = 0; e < 6; ++e) {
    const auto& ends = tetrahedron_edges[e];
    if ((ends[0] == a && ends[1] == b) || (ends[0] == b && ends[1] == a)) return e;
  }
  return -1;
}

struct Facet {
  int cell, n;
  int surface, support;       // -1: none
  std::array<int, 6> corner;  // nodes, as numbers within the cell
  double area;
  Vector3 normal;  // unloaded
};

}  // namespace

struct Mechanics::Implementation {
  const Partition& partition;
  MechanicsSettings settings;
  NodeSpace space;
  int n;  // nodes a cell
  std::vector<QuadraturePoint<4>> rule;
  std::vector<ShapeValues<4>> shapes;
  std::vector<QuadraturePoint<3>> facet_rule;
  std::vector<ShapeValues<3>> facet_shapes;
  std::array<std::array<double, most_nodes>, most_nodes> mass{};  // share of the volume
  std::array<std::array<double, 6>, 6> facet_mass{};

  std::vector<Point> points;       // [cell][quadrature point]
  std::vector<int> material_of;    // of each local cell
  std::vector<char> active, mine;  // conductive; touches an own node
  std::vector<Facet> facets;
  std::vector<char> fixed;  // [own node][direction]
  std::unique_ptr<NodeMatrix> matrix;

  std::vector<double> d, d_last, d_before;
  std::vector<double> stretch_last;  // fibre stretch at d_last, [cell][quadrature point]
  std::vector<CellTension> tension;
  double dt = 0, dt_ratio = 1;  // the step, and over the one before it
  std::vector<double> r;
  std::vector<std::vector<double>> loads;

  Implementation(const Partition& p, MechanicsSettings s)
      : partition(p),
        settings(std::move(s)),
        space(p.make_nodes(settings.order, false)),
        n(space.nodes_per_cell) {}

  std::size_t n_points() const { return rule.size(); }

  // --- what is there ---

  // The middles of edges on curved surfaces, put where they belong.
  void bend_edges() {
    for (const LocalFacet& facet : partition.facets()) {
      const auto nodes = space.nodes_of(facet.cell);
      for (const auto& ends : triangle_edges) {
        const int a = facet.corner[ends[0]], b = facet.corner[ends[1]];
        const int node = nodes[4 + edge_between(a, b)];
        space.points[node] =
            settings.curve(facet.tag, 0.5 * (space.points[nodes[a]] + space.points[nodes[b]]));
      }
    }
    // A ghost's triangles may be known to its owner alone.
    std::vector<double> flat(3 * static_cast<std::size_t>(space.n_local));
    for (int k = 0; k < space.n_local; ++k)
      std::copy(space.points[k].begin(), space.points[k].end(), &flat[3 * static_cast<std::size_t>(k)]);
    partition.update_ghosts(space, flat.data(), 3);
    for (int k = 0; k < space.n_local; ++k)
      std::copy_n(&flat[3 * static_cast<std::size_t>(k)], 3, space.points[k].begin());
  }

  // Gradients of the barycentric coordinates at a point of a cell with curved edges, and the volume it stands
  // for.
  double curved_gradients(int cell, int q, double g[4][3]) const {
    const auto nodes = space.nodes_of(cell);
    Matrix3<double> by_coordinate;  // rows: derivative of the position by coordinates 1, 2, 3
    for (int a = 0; a < n; ++a)
      for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i)
          by_coordinate.m[k][i] +=
              (shapes[q].slope[a][k + 1] - shapes[q].slope[a][0]) * space.points[nodes[a]][i];
    const double det = determinant(by_coordinate);
    const Matrix3<double> cof = cofactors(by_coordinate);
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) g[k + 1][i] = cof.m[k][i] / det;
      g[0][i] = -(g[1][i] + g[2][i] + g[3][i]);
    }
    return det / 6;
  }

  // Points of integration, and what integrals over shape functions alone give.
  void choose_quadrature() {
    const MechanicsSettings& s = settings;
    const int usual_degree = s.order == 1 ? 1 : s.mean_dilatation ? 5 : 2;
    rule = tetrahedron_quadrature(s.quadrature_degree > 0 ? s.quadrature_degree : usual_degree);
    for (const auto& q : rule) shapes.push_back(shape_values<4>(s.order, q.at));
    facet_rule = triangle_quadrature(s.order == 1 ? 2 : 5);
    for (const auto& q : facet_rule) facet_shapes.push_back(shape_values<3>(s.order, q.at));
    for (const auto& q : tetrahedron_quadrature(5)) {
      const auto shape = shape_values<4>(s.order, q.at);
      for (int a = 0; a < n; ++a)
        for (int b = 0; b < n; ++b) mass[a][b] += q.weight * shape.value[a] * shape.value[b];
    }
    const int n_facet_nodes = facet_nodes();
    for (const auto& q : triangle_quadrature(5)) {
      const auto shape = shape_values<3>(s.order, q.at);
      for (int a = 0; a < n_facet_nodes; ++a)
        for (int b = 0; b < n_facet_nodes; ++b)
          facet_mass[a][b] += q.weight * shape.value[a] * shape.value[b];
    }
  }

  int facet_nodes() const { return settings.order == 1 ? 3 : 6; }

  // Materials, frames and gradients of all local cells. Collective.
  void prepare_cells(const FibreField* fibres) {
    const MechanicsSettings& s = settings;
    const TetMesh& mesh = partition.mesh();
    const std::size_t n_cells = partition.cells().size(), n_points = rule.size();
    points.resize(n_cells * n_points);
    material_of.assign(n_cells, -1);
    active.assign(n_cells, 0);
    mine.assign(n_cells, 0);
    collectively(partition.communicator(), [&] {
      for (std::size_t c = 0; c < n_cells; ++c) {
        const int file = partition.cells()[c];
        const int tag = mesh.cell_tags[file];
        for (std::size_t k = 0; k < s.materials.size(); ++k)
          if (s.materials[k].tag == tag) material_of[c] = static_cast<int>(k);
        if (material_of[c] < 0)
          throw InputError(
              fmt::format("mechanics: no material is named for the volume tag {} of the mesh", tag));
        active[c] = mesh_tags::conductive(tag);
        for (int node : space.nodes_of(static_cast<int>(c))) mine[c] |= node < space.n_own;
        double x[4][3], g[4][3];
        for (int v = 0; v < 4; ++v)
          for (int i = 0; i < 3; ++i) x[v][i] = mesh.points[mesh.cells[file][v]][i];
        const double volume = shape_gradients(x, g);
        for (std::size_t q = 0; q < n_points; ++q) {
          Point& point = points[c * n_points + q];
          point.volume = volume * rule[q].weight;
          if (s.order == 2 && s.curve)
            point.volume = rule[q].weight * curved_gradients(static_cast<int>(c), static_cast<int>(q), g);
          if (!(point.volume > 0))
            throw InputError(fmt::format(
                "mechanics: tetrahedron {} with curved edges is turned inside out; use a finer mesh", file));
          const Frame frame = fibres && active[c] ? frame_at(*fibres, mesh, file, rule[q].at)
                                                  : Frame{Point3{1, 0, 0}, Point3{0, 1, 0}, Point3{0, 0, 1}};
          for (int v = 0; v < 4; ++v)
            for (int a = 0; a < 3; ++a)
              point.gradient[v][a] = g[v][0] * frame[a][0] + g[v][1] * frame[a][1] + g[v][2] * frame[a][2];
        }
      }
    });
  }

  // The triangle as this knows it; without surface and support where none is named for its tag.
  Facet facet_of(const LocalFacet& local) const {
    const MechanicsSettings& s = settings;
    const TetMesh& mesh = partition.mesh();
    Facet facet{};
    facet.cell = local.cell;
    facet.n = facet_nodes();
    facet.surface = facet.support = -1;
    for (std::size_t k = 0; k < s.surfaces.size(); ++k)
      if (s.surfaces[k].tag == local.tag) facet.surface = static_cast<int>(k);
    for (std::size_t k = 0; k < s.supports.size(); ++k)
      if (s.supports[k].tag == local.tag) facet.support = static_cast<int>(k);
    for (int k = 0; k < 3; ++k) facet.corner[k] = local.corner[k];
    if (s.order == 2)
      for (int e = 0; e < 3; ++e) {
        const int a = local.corner[triangle_edges[e][0]], b = local.corner[triangle_edges[e][1]];
        facet.corner[3 + e] = 4 + edge_between(a, b);
      }
    const auto& v = mesh.cells[partition.cells()[local.cell]];
    const Point3 &a = mesh.points[v[local.corner[0]]], &b = mesh.points[v[local.corner[1]]],
                 &c = mesh.points[v[local.corner[2]]];
    const Vector3 normal = cross(b - a, c - a);
    facet.area = 0.5 * norm(normal);
    facet.normal = (0.5 / facet.area) * normal;
    return facet;
  }

  void hold_nodes(const Facet& facet) {
    const auto nodes = space.nodes_of(facet.cell);
    for (int k = 0; k < facet.n; ++k)
      for (int i = 0; i < 3; ++i)
        if (settings.supports[facet.support].fixed[i] && nodes[facet.corner[k]] < space.n_own)
          fixed[3 * static_cast<std::size_t>(nodes[facet.corner[k]]) + i] = 1;
  }

  // Triangles that carry a pressure or a support; refuses those of which there are none. Collective.
  void prepare_facets() {
    const MechanicsSettings& s = settings;
    fixed.assign(3 * static_cast<std::size_t>(space.n_own), 0);
    std::vector<int> n_facets_of_surface(s.surfaces.size(), 0), n_facets_of_support(s.supports.size(), 0);
    for (const LocalFacet& local : partition.facets()) {
      const Facet facet = facet_of(local);
      if (facet.surface < 0 && facet.support < 0) continue;
      if (facet.surface >= 0) ++n_facets_of_surface[facet.surface];
      if (facet.support >= 0) {
        ++n_facets_of_support[facet.support];
        hold_nodes(facet);
      }
      // An own cell may have all its nodes on other ranks: its share of the volumes still counts here.
      if (mine[facet.cell] || facet.cell < partition.n_own_cells()) facets.push_back(facet);
    }
    const auto refuse_empty = [&](int count, int tag, const char* what) {
      if (partition.sum(count) == 0)
        throw InputError(
            fmt::format("mechanics: no triangle of the mesh has the surface tag {}, which {}", tag, what));
    };
    for (std::size_t k = 0; k < s.surfaces.size(); ++k)
      refuse_empty(n_facets_of_surface[k], s.surfaces[k].tag, "encloses a cavity or carries a pressure");
    for (std::size_t k = 0; k < s.supports.size(); ++k)
      refuse_empty(n_facets_of_support[k], s.supports[k].tag, "is named as a support");
  }

  void allocate() {
    matrix = std::make_unique<NodeMatrix>(partition, space, 3);
    d.assign(3 * static_cast<std::size_t>(space.n_local), 0.0);
    d_last = d_before = d;
    stretch_last.assign(points.size(), 1.0);
    r.assign(3 * static_cast<std::size_t>(space.n_own), 0.0);
    loads.assign(settings.surfaces.size(), r);
  }

  // --- forces and stiffness ---

  void positions(const std::vector<double>& displacement, int cell, double x[most_nodes][3]) const {
    const auto nodes = space.nodes_of(cell);
    for (int a = 0; a < n; ++a)
      for (int i = 0; i < 3; ++i)
        x[a][i] = space.points[nodes[a]][i] + displacement[3 * static_cast<std::size_t>(nodes[a]) + i];
  }

  void shape_gradients_at(const Point& point, int q, double G[most_nodes][3]) const {
    if (n == 4) {
      std::copy(&point.gradient[0][0], &point.gradient[0][0] + 12, &G[0][0]);
      return;
    }
    for (int a = 0; a < n; ++a)
      for (int i = 0; i < 3; ++i) {
        const auto& slope = shapes[q].slope[a];
        G[a][i] = slope[0] * point.gradient[0][i] + slope[1] * point.gradient[1][i] +
                  slope[2] * point.gradient[2][i] + slope[3] * point.gradient[3][i];
      }
  }

  Matrix3<double> gradient_of(const double x[most_nodes][3], const double G[most_nodes][3]) const {
    Matrix3<double> F;
    // Differences to node 0, so that a shift of the whole changes nothing but round-off of the shape.
    for (int a = 1; a < n; ++a)
      for (int i = 0; i < 3; ++i) {
        const double difference = x[a][i] - x[0][i];
        for (int b = 0; b < 3; ++b) F.m[i][b] += difference * G[a][b];
      }
    return F;
  }

  void update_stretch() {
    double x[most_nodes][3], G[most_nodes][3];
    for (std::size_t c = 0; c < material_of.size(); ++c) {
      if (!active[c]) continue;
      positions(d_last, static_cast<int>(c), x);
      for (std::size_t q = 0; q < n_points(); ++q) {
        shape_gradients_at(points[c * n_points() + q], static_cast<int>(q), G);
        stretch_last[c * n_points() + q] = stretch(gradient_of(x, G), 0);
      }
    }
  }

  template <bool tangent>
  void add_point(int cell, int q, const Matrix3<double>& F, double slope, bool mean, Matrix3<double>& P,
                 double A[9][9]) const {
    const Material& material = settings.materials[material_of[cell]];
    const auto add = [&](const auto& law) {
      if constexpr (tangent)
        add_stress_and_tangent(law, F, P, A);
      else
        add_stress(law, F, P);
    };
    visit_material(material, [&](const auto& law, const auto& volumetric) {
      add(law);
      if (!mean)
        add(volumetric);
      else if constexpr (tangent)
        add_volumetric_stress_and_tangent(slope, 0.0, F, P, A);
      else
        add_volumetric_stress(slope, F, P);
    });
    if (!tension.empty() && active[cell]) {
      ActiveStress stress;
      const CellTension& here = tension[cell];
      for (int k = 0; k < 4; ++k) {
        stress.tension_Pa += rule[q].at[k] * here.tension[k];
        stress.stiffness_Pa += rule[q].at[k] * here.stiffness[k];
      }
      stress.stretch_before = stretch_last[static_cast<std::size_t>(cell) * n_points() + q];
      stress.n_f = settings.n_f;
      stress.n_s = settings.n_s;
      stress.n_n = settings.n_n;
      stress.normalised = settings.normalised_tension;
      add(stress);
    }
  }

  VolumeDerivatives<double> volumetric(int cell, double J) const {
    return visit_material(settings.materials[material_of[cell]], [&](const auto&, const auto& volumetric) {
      return volume_derivatives(volumetric, J);
    });
  }

  template <bool tangent>
  void add_cell(int cell, Balance& balance) {
    const auto nodes = space.nodes_of(cell);
    double x[most_nodes][3], before[most_nodes][3], f[most_nodes][3] = {};
    static thread_local double K[most_nodes][3][most_nodes][3];
    positions(d, cell, x);
    if (dt > 0 && settings.viscosity_Pa_s > 0 && active[cell]) positions(d_last, cell, before);
    const bool mean = settings.mean_dilatation && n == 10;
    double mean_slope = 0, mean_curvature = 0, cell_volume = 0;
    const Point* at = &points[static_cast<std::size_t>(cell) * n_points()];
    for (std::size_t q = 0; q < n_points(); ++q) cell_volume += at[q].volume;
    if (mean) {
      double sum = 0;
      for (std::size_t q = 0; q < n_points(); ++q) {
        double G[most_nodes][3];
        shape_gradients_at(at[q], static_cast<int>(q), G);
        sum += at[q].volume * determinant(gradient_of(x, G));
      }
      const auto U = volumetric(cell, sum / cell_volume);
      mean_slope = U.slope;
      mean_curvature = U.curvature;
    }
    double mean_direction[most_nodes][3] = {};
    for (std::size_t q = 0; q < n_points(); ++q) {
      double G[most_nodes][3];
      shape_gradients_at(at[q], static_cast<int>(q), G);
      const Matrix3<double> F = gradient_of(x, G);
      const double J = determinant(F);
      if (!(J >= balance.smallest_J)) {
        balance.smallest_J = J;
        balance.worst_cell = partition.cells()[cell];
      }
      Matrix3<double> P;
      double A[9][9];
      if constexpr (tangent) std::fill(&A[0][0], &A[0][0] + 81, 0.0);
      add_point<tangent>(cell, static_cast<int>(q), F, mean_slope, mean, P, A);
      if (dt > 0 && settings.viscosity_Pa_s > 0 && active[cell]) {
        WallViscosity viscosity;
        viscosity.eta_Pa_s = settings.viscosity_Pa_s;
        viscosity.dt_s = dt;
        viscosity.strain_before = green_strain(gradient_of(before, G));
        if constexpr (tangent)
          add_stress_and_tangent(viscosity, F, P, A);
        else
          add_stress(viscosity, F, P);
      }
      const double w = at[q].volume;
      if (n == 4) {
        if constexpr (tangent) {
          double k4[4][3][4][3];
          element_force_and_stiffness(G, P, A, w, f, k4);
          for (int a = 0; a < 4; ++a)
            for (int i = 0; i < 3; ++i)
              for (int b = 0; b < 4; ++b)
                for (int j = 0; j < 3; ++j) K[a][i][b][j] = k4[a][i][b][j];
        } else {
          element_force(G, P, w, f);
        }
      } else {
        for (int a = 0; a < n; ++a)
          for (int i = 0; i < 3; ++i)
            f[a][i] += w * (P.m[i][0] * G[a][0] + P.m[i][1] * G[a][1] + P.m[i][2] * G[a][2]);
        if (mean) {
          const Matrix3<double> cof = cofactors(F);
          for (int a = 0; a < n; ++a)
            for (int i = 0; i < 3; ++i)
              mean_direction[a][i] +=
                  w * (cof.m[i][0] * G[a][0] + cof.m[i][1] * G[a][1] + cof.m[i][2] * G[a][2]);
        }
        if constexpr (tangent) {
          if (q == 0) std::fill(&K[0][0][0][0], &K[0][0][0][0] + most_nodes * 3 * most_nodes * 3, 0.0);
          for (int a = 0; a < n; ++a)
            for (int i = 0; i < 3; ++i) {
              double h[9];
              for (int p = 0; p < 9; ++p)
                h[p] = w * (G[a][0] * A[3 * i][p] + G[a][1] * A[3 * i + 1][p] + G[a][2] * A[3 * i + 2][p]);
              for (int b = 0; b < n; ++b)
                for (int j = 0; j < 3; ++j)
                  K[a][i][b][j] += h[3 * j] * G[b][0] + h[3 * j + 1] * G[b][1] + h[3 * j + 2] * G[b][2];
            }
        }
      }
    }
    if constexpr (tangent)
      if (mean) {
        const double factor = mean_curvature / cell_volume;
        for (int a = 0; a < n; ++a)
          for (int i = 0; i < 3; ++i)
            for (int b = 0; b < n; ++b)
              for (int j = 0; j < 3; ++j)
                K[a][i][b][j] += factor * mean_direction[a][i] * mean_direction[b][j];
      }
    if (dt > 0) {
      const double inertia = settings.density * cell_volume / (dt * dt);
      double acceleration[most_nodes][3];
      for (int a = 0; a < n; ++a)
        for (int i = 0; i < 3; ++i) {
          const std::size_t k = 3 * static_cast<std::size_t>(nodes[a]) + i;
          acceleration[a][i] = d[k] - d_last[k] - dt_ratio * (d_last[k] - d_before[k]);
        }
      for (int a = 0; a < n; ++a)
        for (int b = 0; b < n; ++b) {
          const double m = inertia * mass[a][b];
          for (int i = 0; i < 3; ++i) {
            f[a][i] += m * acceleration[b][i];
            if constexpr (tangent) K[a][i][b][i] += m;
          }
        }
    }
    for (int a = 0; a < n; ++a)
      if (nodes[a] < space.n_own)
        for (int i = 0; i < 3; ++i) r[3 * static_cast<std::size_t>(nodes[a]) + i] += f[a][i];
    if constexpr (tangent) {
      const int* slots = matrix->cell_slots(cell);
      for (int a = 0; a < n; ++a) {
        if (nodes[a] >= space.n_own) continue;
        for (int b = 0; b < n; ++b) {
          double* block = matrix->block(slots[a * n + b]);
          for (int j = 0; j < 3; ++j)
            for (int i = 0; i < 3; ++i) block[3 * j + i] += K[a][i][b][j];
        }
      }
    }
  }

  // Forces of the nodes of a triangle and their stiffness.
  struct FacetSums {
    double f[6][3] = {}, K[6][3][6][3] = {};
  };

  // A pressure on the deformed triangle: also its load vector and its share of the enclosed volume.
  template <bool tangent>
  void add_pressure(const Facet& facet, double p, Balance& balance, FacetSums& sums) {
    auto& [f, K] = sums;
    const auto nodes = space.nodes_of(facet.cell);
    double x[6][3];
    for (int a = 0; a < facet.n; ++a) {
      const auto node = static_cast<std::size_t>(nodes[facet.corner[a]]);
      for (int i = 0; i < 3; ++i) x[a][i] = space.points[node][i] + d[3 * node + i];
    }
    const Point3& origin = settings.surfaces[facet.surface].origin;
    double load[6][3] = {};
    double volume = 0;
    for (std::size_t q = 0; q < facet_rule.size(); ++q) {
      const auto& shape = facet_shapes[q];
      Vector3 along{}, across{}, here{};
      double by_xi[6], by_eta[6];
      for (int a = 0; a < facet.n; ++a) {
        by_xi[a] = shape.slope[a][1] - shape.slope[a][0];
        by_eta[a] = shape.slope[a][2] - shape.slope[a][0];
        for (int i = 0; i < 3; ++i) {
          along[i] += by_xi[a] * x[a][i];
          across[i] += by_eta[a] * x[a][i];
          here[i] += shape.value[a] * x[a][i];
        }
      }
      const double w = 0.5 * facet_rule[q].weight;  // the reference triangle's area
      const Vector3 normal = cross(along, across);
      volume -= w / 3 * dot(here - origin, normal);
      for (int a = 0; a < facet.n; ++a)
        for (int i = 0; i < 3; ++i) load[a][i] += w * shape.value[a] * normal[i];
      if constexpr (tangent) {
        for (int a = 0; a < facet.n; ++a) {
          const double s = p * w * shape.value[a];
          for (int b = 0; b < facet.n; ++b) {
            // d(along x across) = d along x across + along x d across.
            const double u = s * by_xi[b], v = s * by_eta[b];
            const Vector3 t = {v * along[0] - u * across[0], v * along[1] - u * across[1],
                               v * along[2] - u * across[2]};
            K[a][0][b][1] -= t[2];
            K[a][0][b][2] += t[1];
            K[a][1][b][0] += t[2];
            K[a][1][b][2] -= t[0];
            K[a][2][b][0] -= t[1];
            K[a][2][b][1] += t[0];
          }
        }
      }
    }
    if (facet.cell < partition.n_own_cells()) balance.volumes_m3[facet.surface] += volume;
    for (int a = 0; a < facet.n; ++a) {
      const auto node = static_cast<std::size_t>(nodes[facet.corner[a]]);
      for (int i = 0; i < 3; ++i) {
        f[a][i] += p * load[a][i];
        if (static_cast<int>(node) < space.n_own) loads[facet.surface][3 * node + i] += load[a][i];
      }
    }
  }

  template <bool tangent>
  void add_support(const Facet& facet, FacetSums& sums) const {
    auto& [f, K] = sums;
    const auto nodes = space.nodes_of(facet.cell);
    const Support& support = settings.supports[facet.support];
    const double normal_factor = support.normal_stiffness + (dt > 0 ? support.normal_damping / dt : 0);
    const double full_factor = support.full_stiffness + (dt > 0 ? support.full_damping / dt : 0);
    double matrix3[3][3], damping[3][3];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        const double nn = facet.normal[i] * facet.normal[j], one = i == j ? 1 : 0;
        matrix3[i][j] = normal_factor * nn + full_factor * one;
        damping[i][j] = dt > 0 ? support.normal_damping / dt * nn + support.full_damping / dt * one : 0.0;
      }
    for (int a = 0; a < facet.n; ++a)
      for (int b = 0; b < facet.n; ++b) {
        const double m = facet.area * facet_mass[a][b];
        const auto node = static_cast<std::size_t>(nodes[facet.corner[b]]);
        for (int i = 0; i < 3; ++i)
          for (int j = 0; j < 3; ++j) {
            f[a][i] += m * (matrix3[i][j] * d[3 * node + j] - damping[i][j] * d_last[3 * node + j]);
            if constexpr (tangent) K[a][i][b][j] += m * matrix3[i][j];
          }
      }
  }

  template <bool tangent>
  void add_facet(const Facet& facet, std::span<const double> pressures, Balance& balance) {
    FacetSums sums;
    if (facet.surface >= 0) add_pressure<tangent>(facet, pressures[facet.surface], balance, sums);
    if (facet.support >= 0) add_support<tangent>(facet, sums);
    const auto& [f, K] = sums;
    const auto nodes = space.nodes_of(facet.cell);
    for (int a = 0; a < facet.n; ++a) {
      const int node = nodes[facet.corner[a]];
      if (node >= space.n_own) continue;
      for (int i = 0; i < 3; ++i) r[3 * static_cast<std::size_t>(node) + i] += f[a][i];
      if constexpr (tangent) {
        const int* slots = matrix->cell_slots(facet.cell);
        for (int b = 0; b < facet.n; ++b) {
          double* block = matrix->block(slots[facet.corner[a] * n + facet.corner[b]]);
          for (int j = 0; j < 3; ++j)
            for (int i = 0; i < 3; ++i) block[3 * j + i] += K[a][i][b][j];
        }
      }
    }
  }

  void hold_fixed_rows() {
    for (std::size_t k = 0; k < fixed.size(); ++k)
      if (fixed[k]) {
        r[k] = 0;
        for (auto& load : loads) load[k] = 0;
      }
  }

  // Rows of held directions: the diagonal alone. Their columns may stay, as the step there is zero.
  void hold_fixed_matrix_rows() {
    for (std::size_t c = 0; c < material_of.size(); ++c) {
      if (!mine[c]) continue;
      const auto nodes = space.nodes_of(static_cast<int>(c));
      const int* slots = matrix->cell_slots(static_cast<int>(c));
      for (int a = 0; a < n; ++a) {
        if (nodes[a] >= space.n_own) continue;
        for (int i = 0; i < 3; ++i) {
          if (!fixed[3 * static_cast<std::size_t>(nodes[a]) + i]) continue;
          for (int b = 0; b < n; ++b) {
            double* block = matrix->block(slots[a * n + b]);
            for (int j = 0; j < 3; ++j) block[3 * j + i] = 0;
          }
        }
      }
    }
    for (int node = 0; node < space.n_own; ++node)
      for (int i = 0; i < 3; ++i)
        if (fixed[3 * static_cast<std::size_t>(node) + i])
          matrix->block(matrix->diagonal_slot(node))[4 * i] = fixed_row_stiffness;
  }

  template <bool tangent>
  void assemble_all(std::span<const double> pressures, Balance& balance) {
    for (std::size_t c = 0; c < material_of.size(); ++c)
      if (mine[c]) add_cell<tangent>(static_cast<int>(c), balance);
    for (const Facet& facet : facets) add_facet<tangent>(facet, pressures, balance);
  }
};

Mechanics::Mechanics(const Partition& partition, const FibreField* fibres, MechanicsSettings settings)
    : me_(std::make_unique<Implementation>(partition, std::move(settings))) {
  me_->choose_quadrature();
  if (me_->settings.order == 2 && me_->settings.curve) me_->bend_edges();
  me_->prepare_cells(fibres);
  me_->prepare_facets();
  me_->allocate();
}

Mechanics::~Mechanics() = default;

const NodeSpace& Mechanics::nodes() const { return me_->space; }
const MechanicsSettings& Mechanics::settings() const { return me_->settings; }
const Partition& Mechanics::partition() const { return me_->partition; }
std::vector<double>& Mechanics::displacement() { return me_->d; }
const std::vector<double>& Mechanics::displacement() const { return me_->d; }
std::vector<double>& Mechanics::last_displacement() { return me_->d_last; }
std::vector<double>& Mechanics::displacement_before_last() { return me_->d_before; }
void Mechanics::set_step(double dt_s, double dt_last_s) {
  me_->dt = dt_s;
  me_->dt_ratio = dt_last_s > 0 ? dt_s / dt_last_s : 1;
}
void Mechanics::set_tension(std::vector<CellTension> tension) {
  me_->tension = std::move(tension);
  if (!me_->tension.empty()) me_->update_stretch();
}
const std::vector<double>& Mechanics::residual() const { return me_->r; }
const std::vector<double>& Mechanics::load(int surface) const { return me_->loads[surface]; }
NodeMatrix& Mechanics::matrix() { return *me_->matrix; }

double Mechanics::product(const std::vector<double>& a, const std::vector<double>& b) const {
  double sum = 0;
  for (std::size_t k = 0; k < me_->r.size(); ++k) sum += a[k] * b[k];
  return me_->partition.sum(sum);
}

Balance Mechanics::assemble(std::span<const double> pressures_Pa, bool tangent) {
  auto& me = *me_;
  Balance balance;
  balance.smallest_J = std::numeric_limits<double>::infinity();
  balance.volumes_m3.assign(me.settings.surfaces.size(), 0.0);
  std::fill(me.r.begin(), me.r.end(), 0.0);
  for (auto& load : me.loads) std::fill(load.begin(), load.end(), 0.0);
  if (tangent) {
    me.matrix->set_zero();
    me.assemble_all<true>(pressures_Pa, balance);
    me.hold_fixed_matrix_rows();
    me.matrix->finish();
  } else {
    me.assemble_all<false>(pressures_Pa, balance);
  }
  me.hold_fixed_rows();
  // One exchange for all scalars.
  struct {
    double value;
    int cell;
  } worst{balance.smallest_J, balance.worst_cell}, all_worst{};
  std::vector<double> sums = balance.volumes_m3, all(sums.size() + 1);
  double squares = 0;
  for (double value : me.r) squares += value * value;
  sums.push_back(squares);
  MPI_Allreduce(sums.data(), all.data(), static_cast<int>(sums.size()), MPI_DOUBLE, MPI_SUM,
                me.partition.communicator());
  MPI_Allreduce(&worst, &all_worst, 1, MPI_DOUBLE_INT, MPI_MINLOC, me.partition.communicator());
  balance.smallest_J = all_worst.value;
  balance.worst_cell = all_worst.cell;
  balance.residual = std::sqrt(all.back());
  balance.finite = std::isfinite(balance.residual);
  std::copy(all.begin(), all.end() - 1, balance.volumes_m3.begin());
  return balance;
}

std::pair<double, int> Mechanics::smallest_volume_ratio(const std::vector<double>& displacement) const {
  const auto& me = *me_;
  struct {
    double value;
    int cell;
  } worst{std::numeric_limits<double>::infinity(), -1}, all{};
  double x[most_nodes][3], G[most_nodes][3];
  for (std::size_t c = 0; c < me.material_of.size(); ++c) {
    me.positions(displacement, static_cast<int>(c), x);
    for (std::size_t q = 0; q < me.n_points(); ++q) {
      me.shape_gradients_at(me.points[c * me.n_points() + q], static_cast<int>(q), G);
      const double J = determinant(me.gradient_of(x, G));
      if (!(J >= worst.value)) worst = {std::isfinite(J) ? J : -1e300, me.partition.cells()[c]};
    }
  }
  MPI_Allreduce(&worst, &all, 1, MPI_DOUBLE_INT, MPI_MINLOC, me.partition.communicator());
  return {all.value, all.cell};
}

void Mechanics::accept() {
  me_->d_before = me_->d_last;
  me_->d_last = me_->d;
}

std::vector<std::array<double, 4>> Mechanics::cell_deformation() const {
  const auto& me = *me_;
  std::vector<std::array<double, 4>> all(me.material_of.size());
  double x[most_nodes][3], G[most_nodes][3];
  for (std::size_t c = 0; c < all.size(); ++c) {
    me.positions(me.d, static_cast<int>(c), x);
    all[c] = {};
    for (std::size_t q = 0; q < me.n_points(); ++q) {
      me.shape_gradients_at(me.points[c * me.n_points() + q], static_cast<int>(q), G);
      const Matrix3<double> F = me.gradient_of(x, G);
      for (int k = 0; k < 3; ++k) {
        const double length = stretch(F, k);
        all[c][k] += me.rule[q].weight * length * length;
      }
      all[c][3] += me.rule[q].weight * determinant(F);
    }
  }
  return all;
}

void Mechanics::require_meaningful(const Balance& balance) const {
  if (balance.smallest_J >= smallest_meaningful_J) return;
  throw NumericalFailure(fmt::format(
      "unphysical: tissue is squeezed to J = {:.3g} of its volume in {}; below {:g} not even its dry matter "
      "has room, and the material law means nothing. Try a finer mesh, a larger bulk modulus (bulk_Pa), "
      "quadratic displacements (mechanics.order = 2), or a smaller load or tension",
      balance.smallest_J, place_of_cell(balance.worst_cell), smallest_meaningful_J));
}

std::string Mechanics::place_of_cell(int file_cell) const {
  const TetMesh& mesh = me_->partition.mesh();
  if (file_cell < 0) return "an unknown cell";
  Point3 centre{};
  for (int v : mesh.cells[file_cell])
    for (int i = 0; i < 3; ++i) centre[i] += 250 * mesh.points[v][i];
  return fmt::format("tetrahedron {} (volume tag {}) at ({:.1f}, {:.1f}, {:.1f}) mm", file_cell,
                     mesh.cell_tags[file_cell], centre[0], centre[1], centre[2]);
}

}  // namespace wiggers
