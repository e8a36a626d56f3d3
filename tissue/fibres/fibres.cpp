#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>
#include <wiggers/tissue/fibres/fibres.hpp>
#include <wiggers/tissue/fibres/laplace.hpp>
#include <wiggers/tissue/laws/tensor.hpp>

namespace wiggers {

namespace {

constexpr double radian_per_deg = std::numbers::pi / 180;

std::size_t at(int i) { return static_cast<std::size_t>(i); }

// ---- directions and frames -------------------------------------------------------------------------------

Point3 normalized(const Point3& v) { return 1 / norm(v) * v; }

// Any unit vector at a right angle to v, always the same one.
Point3 some_perpendicular(const Point3& v) {
  const auto smallest = static_cast<std::size_t>(
      std::min_element(v.begin(), v.end(), [](double a, double b) { return std::abs(a) < std::abs(b); }) -
      v.begin());
  Point3 unit{};
  unit[smallest] = 1;
  return normalized(cross(v, unit));
}

// The part of v at a right angle to the unit vector e, normalised; where there is none (at the apex, where
// the wall's coordinates degenerate) some direction at a right angle.
Point3 orthogonal_part(const Point3& v, const Point3& e) {
  const Point3 rest = v - dot(v, e) * e;
  if (!(norm(rest) > 1e-8 * norm(v))) return some_perpendicular(e);
  return normalized(rest - dot(rest, e) * e);  // twice is enough to machine accuracy
}

// A right-handed frame as a matrix: its directions are the columns.
using Rotation = Eigen::Matrix3d;

Eigen::Vector3d to_eigen(const Point3& p) { return {p[0], p[1], p[2]}; }

Rotation to_rotation(const Frame& frame) {
  Rotation m;
  for (std::size_t k = 0; k < 3; ++k) m.col(static_cast<Eigen::Index>(k)) = to_eigen(frame[k]);
  return m;
}

// Orthonormal again to the last bit: f keeps its direction, s the plane it spans with f.
Frame orthonormalized(const Point3& fibre, const Point3& sheet) {
  const Point3 f = normalized(fibre);
  const Point3 s = orthogonal_part(sheet, f);
  return {f, s, cross(f, s)};
}

Frame to_frame(const Rotation& m) {
  return orthonormalized({m(0, 0), m(1, 0), m(2, 0)}, {m(0, 1), m(1, 1), m(2, 1)});
}

// The wall's axes e_l, e_n, e_t at a point, and the angles by which the rule turns the frame out of them.
struct WallFrame {
  Frame axes;
  double alpha_deg = 0, beta_deg = 0;

  Frame frame() const { return turned_frame(axes, alpha_deg, beta_deg); }
};

// `outward` is the transmural direction from the endocardium to the outside, `longitudinal` points to the
// base; neither needs to be normalised.
WallFrame wall_frame(const Point3& longitudinal, const Point3& outward, double alpha_deg, double beta_deg) {
  const bool has_outward = norm(outward) > 0, has_longitudinal = norm(longitudinal) > 0;
  const Point3 e_t = has_outward        ? normalized(outward)
                     : has_longitudinal ? some_perpendicular(longitudinal)
                                        : Point3{0, 0, 1};
  const Point3 e_n = has_longitudinal ? orthogonal_part(longitudinal, e_t) : some_perpendicular(e_t);
  return {{cross(e_n, e_t), e_n, e_t}, alpha_deg, beta_deg};
}

// The four frames that have the lines of one: itself, and turned half round each of its directions.
std::array<Eigen::Quaterniond, 4> half_turns() {
  return {Eigen::Quaterniond(1, 0, 0, 0), Eigen::Quaterniond(0, 1, 0, 0), Eigen::Quaterniond(0, 0, 1, 0),
          Eigen::Quaterniond(0, 0, 0, 1)};
}

// Which half turn of `b` comes nearest to `a`, and the cosine of half the angle that is left: at least 1/2.
std::pair<std::size_t, double> nearest_half_turn(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  const Eigen::Quaterniond between = b.conjugate() * a;
  const std::array<double, 4> closeness = {std::abs(between.w()), std::abs(between.x()),
                                           std::abs(between.y()), std::abs(between.z())};
  std::size_t nearest = 0;
  for (std::size_t k = 1; k < 4; ++k)
    if (closeness[k] > closeness[nearest] + 1e-12) nearest = k;
  return {nearest, closeness[nearest]};
}

// Spherical interpolation from a to the nearest of the four frames that have the lines of b.
Frame blended(const Frame& a, const Frame& b, double weight) {
  if (weight <= 0) return a;
  if (weight >= 1) return b;
  const Eigen::Quaterniond from(to_rotation(a)), to(to_rotation(b));
  const Eigen::Quaterniond nearest = to * half_turns()[nearest_half_turn(from, to).first];
  return to_frame(from.slerp(weight, nearest).normalized().toRotationMatrix());
}

// ---- sets of vertices ------------------------------------------------------------------------------------

using Vertices = std::vector<int>;

std::array<int, 3> face_of(const std::array<int, 4>& cell, std::size_t opposite) {
  std::array<int, 3> face{};
  for (std::size_t i = 0, k = 0; i < 4; ++i)
    if (i != opposite) face[k++] = cell[i];
  std::sort(face.begin(), face.end());
  return face;
}

// Tag of the myocardial cell that each facet belongs to; 0 where there is none.
std::vector<int> owners_of_facets(const TetMesh& mesh) {
  std::map<std::array<int, 3>, std::vector<std::size_t>> facets;
  std::vector<char> on_facet(mesh.points.size(), 0);
  for (std::size_t i = 0; i < mesh.facets.size(); ++i) {
    auto key = mesh.facets[i];
    for (int v : key) on_facet[at(v)] = 1;
    std::sort(key.begin(), key.end());
    facets[key].push_back(i);
  }
  std::vector<int> owners(mesh.facets.size(), 0);
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    if (!mesh_tags::conductive(mesh.cell_tags[c])) continue;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto face = face_of(mesh.cells[c], i);
      if (!on_facet[at(face[0])] || !on_facet[at(face[1])] || !on_facet[at(face[2])]) continue;
      const auto found = facets.find(face);
      if (found == facets.end()) continue;
      for (std::size_t facet : found->second) owners[facet] = mesh.cell_tags[c];
    }
  }
  return owners;
}

template <class Condition>
std::vector<char> vertices_of_cells(const TetMesh& mesh, Condition condition) {
  std::vector<char> marked(mesh.points.size(), 0);
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (condition(mesh.cell_tags[c]))
      for (int v : mesh.cells[c]) marked[at(v)] = 1;
  return marked;
}

template <class Condition>
Vertices select_vertices(const std::vector<char>& marked, Condition condition) {
  Vertices chosen;
  for (std::size_t v = 0; v < marked.size(); ++v)
    if (marked[v] && condition(static_cast<int>(v))) chosen.push_back(static_cast<int>(v));
  return chosen;
}

Vertices joined(Vertices a, const Vertices& b) {
  a.insert(a.end(), b.begin(), b.end());
  std::sort(a.begin(), a.end());
  a.erase(std::unique(a.begin(), a.end()), a.end());
  return a;
}

Point3 centroid(const TetMesh& mesh, const Vertices& vertices) {
  Point3 sum{};
  for (int v : vertices) sum = sum + mesh.points[at(v)];
  return 1.0 / static_cast<double>(std::max<std::size_t>(1, vertices.size())) * sum;
}

Point3 centroid_of_cells(const TetMesh& mesh, int tag) {
  return centroid(mesh, select_vertices(vertices_of_cells(mesh, [&](int t) { return t == tag; }),
                                        [](int) { return true; }));
}

// A mesh with what is asked of it again and again.
struct Surfaces {
  explicit Surfaces(const TetMesh& m) : mesh(m), owners(owners_of_facets(m)) {}

  // Vertices of the facets with one of these tags that belong to cells of a volume.
  Vertices on(std::initializer_list<int> tags, int volume) const {
    Vertices vertices;
    for (std::size_t i = 0; i < mesh.facets.size(); ++i)
      if (owners[i] == volume && std::find(tags.begin(), tags.end(), mesh.facet_tags[i]) != tags.end())
        vertices.insert(vertices.end(), mesh.facets[i].begin(), mesh.facets[i].end());
    return joined(vertices, {});
  }
  // Vertices that a volume shares with cells of other volumes.
  template <class Condition>
  Vertices shared(int volume, Condition other) const {
    const auto theirs = vertices_of_cells(mesh, other);
    return select_vertices(vertices_of_cells(mesh, [&](int tag) { return tag == volume; }),
                           [&](int v) { return theirs[at(v)] != 0; });
  }

  const TetMesh& mesh;
  std::vector<int> owners;
};

// ---- ventricles ------------------------------------------------------------------------------------------

struct VentricularSets {
  Vertices endocardium_left, endocardium_right, epicardium, base;
  Point3 upwards;  // unit vector from apex to base
};

// Mean normal of the base, out of the myocardium; where the base faces itself (a lone rim around a disc) the
// direction from the middle of the myocardium to the middle of the base.
Point3 direction_of_base(const TetMesh& mesh, const Vertices& base) {
  std::vector<char> on_base(mesh.points.size(), 0);
  for (int v : base) on_base[at(v)] = 1;
  std::map<std::array<int, 3>, std::pair<int, Point3>> faces;  // how often, area times outer normal
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    if (mesh.cell_tags[c] != mesh_tags::ventricles) continue;
    const auto& cell = mesh.cells[c];
    const auto n_on_base =
        std::count_if(cell.begin(), cell.end(), [&](int v) { return on_base[at(v)] != 0; });
    if (n_on_base < 3) continue;
    const CellGeometry g = cell_geometry(mesh, static_cast<int>(c));
    for (std::size_t i = 0; i < 4; ++i) {
      const auto face = face_of(cell, i);
      if (!on_base[at(face[0])] || !on_base[at(face[1])] || !on_base[at(face[2])]) continue;
      auto& entry = faces[face];
      ++entry.first;
      entry.second = -3 * g.volume * g.gradients[i];
    }
  }
  Point3 normal{};
  double area = 0;
  for (const auto& [face, entry] : faces)
    if (entry.first == 1) {
      normal = normal + entry.second;
      area += norm(entry.second);
    }
  if (norm(normal) > 0.3 * area) return normalized(normal);
  const Point3 up = centroid(mesh, base) - centroid_of_cells(mesh, mesh_tags::ventricles);
  return norm(up) > 0 ? normalized(up) : Point3{0, 0, 1};
}

VentricularSets ventricular_sets(const Surfaces& surfaces) {
  using namespace mesh_tags;
  const TetMesh& mesh = surfaces.mesh;
  VentricularSets sets;
  sets.endocardium_left = surfaces.on({endocardium_LV}, ventricles);
  sets.endocardium_right = surfaces.on({endocardium_RV}, ventricles);
  sets.base = surfaces.shared(ventricles, [](int tag) { return !conductive(tag); });
  const bool truncated =
      std::find(mesh.cell_tags.begin(), mesh.cell_tags.end(), annuli) == mesh.cell_tags.end();
  if (truncated) {
    // The rim of a cap within the cavity is no base: grad psi would turn across the wall there.
    const Vertices cut = surfaces.on({epicardium_fat, rings}, ventricles);
    if (!cut.empty()) sets.base = cut;
    sets.epicardium = surfaces.on({mesh_tags::epicardium}, ventricles);
  } else {
    sets.epicardium = surfaces.on({mesh_tags::epicardium, epicardium_fat}, ventricles);
  }
  if (sets.endocardium_left.empty())
    throw InputError(
        fmt::format("fibres: no facet of the ventricles (volume {}) is tagged {} (endocardium-LV)",
                    ventricles, endocardium_LV));
  if (sets.epicardium.empty())
    throw InputError(fmt::format("fibres: no facet of the ventricles (volume {}) is tagged {} (epicardium)",
                                 ventricles, mesh_tags::epicardium));
  if (sets.base.empty())
    throw InputError(fmt::format(
        "fibres: the ventricles (volume {}) have no base: they neither touch a non-conductive volume "
        "(annuli {}, valves {}, caps {}) nor have facets tagged {} or {}",
        ventricles, annuli, valves, caps, epicardium_fat, rings));
  sets.upwards = direction_of_base(mesh, sets.base);
  return sets;
}

// The vertex farthest down; of several (a flat bottom) the one nearest to the axis through the base's middle.
int lowest(const TetMesh& mesh, const Vertices& vertices, const VentricularSets& sets) {
  const Point3 middle = centroid(mesh, sets.base);
  const auto below = [&](int v) { return dot(middle - mesh.points[at(v)], sets.upwards); };
  double depth = -unbounded;
  for (int v : vertices) depth = std::max(depth, below(v));
  int chosen = -1;
  double nearest = unbounded;
  for (int v : vertices) {
    if (below(v) < depth - 1e-6 * std::abs(depth)) continue;
    const double off_axis = norm(cross(mesh.points[at(v)] - middle, sets.upwards));
    if (off_axis < nearest) {
      nearest = off_axis;
      chosen = v;
    }
  }
  return chosen;
}

double distance_to(const TetMesh& mesh, int vertex, const Vertices& others) {
  double best = unbounded;
  for (int v : others) best = std::min(best, norm(mesh.points[at(v)] - mesh.points[at(vertex)]));
  return best;
}

// Longitudinal direction of one ventricle, and how much of it is outflow tract (0 .. 1).
struct Longitudinal {
  std::vector<Point3> direction;
  std::vector<double> outflow;
};

Longitudinal apex_to_base(const LaplaceProblem& problem, const std::vector<double>& psi) {
  return {problem.vertex_gradients(psi), std::vector<double>(psi.size(), 0)};
}

// Doste et al.: w grad psi_inflow + (1 - w) grad psi_outflow. Without an outflow ring: apex to base.
// A vertex alone holds no harmonic field (its capacity is zero): w = 1 at the apex only would leave the whole
// ventricle near the mean of its rings. Therefore w = 1 in the lower half of the ventricles.
Longitudinal with_outflow_tract(const LaplaceProblem& problem, const std::string& side, int apex,
                                const Vertices& lower_half, const Vertices& inflow, const Vertices& outflow,
                                const std::vector<double>& psi) {
  if (inflow.empty() || outflow.empty()) return apex_to_base(problem, psi);
  const BoundarySet bottom{side + " apex", {apex}}, in{side + " inflow ring", inflow},
      out{side + " outflow ring", outflow};
  const auto to_inflow = problem.vertex_gradients(problem.solve(std::vector{in, bottom}, {1, 0}));
  const auto to_outflow = problem.vertex_gradients(problem.solve(std::vector{out, bottom}, {1, 0}));
  const auto w = problem.solve(std::vector{in, out, BoundarySet{"lower half", lower_half}}, {1, 0, 1});
  Longitudinal result{to_inflow, w};
  for (std::size_t v = 0; v < w.size(); ++v) {
    result.direction[v] = w[v] * to_inflow[v] + (1 - w[v]) * to_outflow[v];
    result.outflow[v] = 1 - w[v];
  }
  return result;
}

FibreAngles mixed(const FibreAngles& a, const FibreAngles& b, double share_of_b) {
  const auto mix = [&](double x, double y) { return (1 - share_of_b) * x + share_of_b * y; };
  return {mix(a.alpha_endo, b.alpha_endo), mix(a.alpha_epi, b.alpha_epi), mix(a.beta_endo, b.beta_endo),
          mix(a.beta_epi, b.beta_epi)};
}

// xi of the Laplace problem made steep in the septum: a logistic of width 0.1 that still ends at 0 and 1.
double steepened(double xi) {
  constexpr double width = 0.1;
  const auto logistic = [&](double x) { return 1 / (1 + std::exp(-(x - 0.5) / width)); };
  return std::clamp((logistic(xi) - logistic(0)) / (logistic(1) - logistic(0)), 0.0, 1.0);
}

// What both rules need to know of one vertex of the ventricles.
struct WallPoint {
  double left, right, outer;  // phi_left, phi_right, phi_epi
  double xi;
  Point3 grad_left, grad_right;
  Point3 longitudinal_left, longitudinal_right;
  FibreAngles angles_left, angles_right;
};

// The axes from which these angles lead to the lines of `blend`, a frame near that of `main`.
WallFrame with_angles_of(const WallFrame& main, const Frame& blend) {
  const Frame turn = turned_frame({{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, main.alpha_deg, main.beta_deg);
  const Rotation frame = to_rotation(blend);
  const Eigen::Quaterniond wanted(to_rotation(main.frame())), there(frame);
  const Eigen::Quaterniond same_lines = there * half_turns()[nearest_half_turn(wanted, there).first];
  return {to_frame(same_lines.toRotationMatrix() * to_rotation(turn).transpose()), main.alpha_deg,
          main.beta_deg};
}

WallFrame bayer_frame(const WallPoint& p) {
  const FibreAngles &l = p.angles_left, &r = p.angles_right;
  const FibreAngles epi = mixed(r, l, p.xi);
  const double alpha_epi = p.outer * epi.alpha_epi, beta_epi = p.outer * epi.beta_epi;
  const auto frame = [&](const Point3& longitudinal, const Point3& outward, double sign_left,
                         double sign_right) {
    return wall_frame(longitudinal, outward,
                      sign_left * p.left * l.alpha_endo + sign_right * p.right * r.alpha_endo + alpha_epi,
                      sign_left * p.left * l.beta_endo + sign_right * p.right * r.beta_endo + beta_epi);
  };
  const WallFrame from_left = frame(p.longitudinal_left, -1.0 * p.grad_left, 1, -1);
  if (p.right == 0 && norm(p.grad_right) == 0) return from_left;  // a lone left ventricle
  const WallFrame from_right = frame(p.longitudinal_right, -1.0 * p.grad_right, -1, 1);
  const Point3 longitudinal = p.xi * p.longitudinal_left + (1 - p.xi) * p.longitudinal_right;
  const WallFrame outer = frame(longitudinal, -1.0 * (p.grad_left + p.grad_right), 1, 1);
  const double inside = p.left + p.right, share_right = inside > 0 ? p.right / inside : 1 - p.xi;
  const Frame inner = blended(from_left.frame(), from_right.frame(), share_right);
  // The angles are those of the wall that weighs most. Where walls meet at an angle no other choice is
  // better; elsewhere all three lead to the same lines.
  const WallFrame& main = p.outer >= 0.5 ? outer : share_right >= 0.5 ? from_right : from_left;
  return with_angles_of(main, blended(inner, outer.frame(), p.outer));
}

WallFrame doste_frame(const WallPoint& p) {
  const double transmural = 2 * p.left - p.right;
  const Point3 gradient = 2.0 * p.grad_left - p.grad_right;
  // On the epicardium both fields vanish; there xi tells the ventricle.
  const bool left = transmural > 0 || (transmural == 0 && p.xi >= 0.5);
  const double depth = left ? transmural / 2 : -transmural;
  const FibreAngles& own = left ? p.angles_left : p.angles_right;
  const FibreAngles epi = mixed(p.angles_right, p.angles_left, p.xi);
  return wall_frame(left ? p.longitudinal_left : p.longitudinal_right, (left ? -1.0 : 1.0) * gradient,
                    depth * own.alpha_endo + p.outer * epi.alpha_epi,
                    depth * own.beta_endo + p.outer * epi.beta_epi);
}

// The harmonic coordinates of the ventricles; fills the scalar fields of `field`.
struct VentricularCoordinates {
  std::vector<double> left, right;
};

VentricularCoordinates ventricular_coordinates(const LaplaceProblem& problem, const VentricularSets& sets,
                                               int apex, FibreField& field) {
  const BoundarySet endo_left{"endocardium-LV (surface 24)", sets.endocardium_left};
  const BoundarySet endo_right{"endocardium-RV (surface 23)", sets.endocardium_right};
  const BoundarySet outside{"epicardium (surface 31)", sets.epicardium};
  const bool two_chambers = !sets.endocardium_right.empty();
  VentricularCoordinates c;
  std::vector<double> xi;
  if (two_chambers) {
    auto phi = problem.solve_several(std::vector{endo_left, endo_right, outside}, {{1, 0, 0}, {0, 1, 0}});
    c = {std::move(phi[0]), std::move(phi[1])};
    xi = problem.solve(std::vector{endo_left, endo_right}, {1, 0});
  } else {
    c = {problem.solve(std::vector{endo_left, outside}, {1, 0}), std::vector<double>(field.frames.size(), 0)};
  }
  const auto psi =
      problem.solve(std::vector{BoundarySet{"base", sets.base}, BoundarySet{"apex", {apex}}}, {1, 0});
  for (std::size_t v = 0; v < field.frames.size(); ++v) {
    check_interrupt();
    if (!problem.in_region(static_cast<int>(v))) continue;
    field.transmural[v] = std::max(c.left[v], c.right[v]);
    field.endocardial_distance[v] = 1 - field.transmural[v];
    if (two_chambers) field.interventricular[v] = steepened(xi[v]);
    field.apex_base[v] = psi[v];
  }
  return c;
}

void set_vertex(FibreField& field, std::size_t v, const WallFrame& wall) {
  field.axes[v] = wall.axes;
  field.alpha_deg[v] = wall.alpha_deg;
  field.beta_deg[v] = wall.beta_deg;
  field.frames[v] = wall.frame();
}

void add_ventricles(const Surfaces& surfaces, const FibreRule& rule, FibreField& field) {
  using namespace mesh_tags;
  const TetMesh& mesh = surfaces.mesh;
  const VentricularSets sets = ventricular_sets(surfaces);
  const LaplaceProblem problem(mesh, {ventricles});
  const int apex = lowest(mesh, sets.epicardium, sets);
  const VentricularCoordinates c = ventricular_coordinates(problem, sets, apex, field);
  const bool two_chambers = !sets.endocardium_right.empty();

  Longitudinal left = apex_to_base(problem, field.apex_base), right = left;
  if (rule.kind == FibreRuleKind::doste) {
    const auto everything = [](int) { return true; };
    const auto near = [&](int tag_a, int tag_b) {
      return select_vertices(vertices_of_cells(mesh, [&](int t) { return t == tag_a || t == tag_b; }),
                             everything);
    };
    const Vertices atria = near(left_atrium, right_atrium);
    const double middle =
        (dot(mesh.points[at(apex)], sets.upwards) + dot(centroid(mesh, sets.base), sets.upwards)) / 2;
    Vertices lower_half = near(ventricles, ventricles);
    std::erase_if(lower_half, [&](int v) { return dot(mesh.points[at(v)], sets.upwards) > middle; });
    const auto one_side = [&](const std::string& name, bool on_left, int artery_tag) {
      const Vertices artery = near(artery_tag, artery_tag);
      const auto here = [&](int v) { return (field.interventricular[at(v)] >= 0.5) == on_left; };
      Vertices inflow, outflow, outside;
      for (int v : sets.base)
        if (here(v))
          (distance_to(mesh, v, artery) < distance_to(mesh, v, atria) ? outflow : inflow).push_back(v);
      std::copy_if(sets.epicardium.begin(), sets.epicardium.end(), std::back_inserter(outside), here);
      if (outside.empty()) outside = sets.epicardium;
      return with_outflow_tract(problem, name, lowest(mesh, outside, sets), lower_half, inflow, outflow,
                                field.apex_base);
    };
    left = one_side("left", true, aorta);
    if (two_chambers) right = one_side("right", false, pulmonary_trunk);
  }

  const auto grad_left = problem.vertex_gradients(c.left), grad_right = problem.vertex_gradients(c.right);
  for (std::size_t v = 0; v < mesh.points.size(); ++v) {
    check_interrupt();
    if (!problem.in_region(static_cast<int>(v))) continue;
    const WallPoint p{c.left[v],
                      c.right[v],
                      std::clamp(1 - c.left[v] - c.right[v], 0.0, 1.0),
                      field.interventricular[v],
                      grad_left[v],
                      grad_right[v],
                      left.direction[v],
                      right.direction[v],
                      mixed(rule.left, rule.left_outflow, left.outflow[v]),
                      mixed(rule.right, rule.right_outflow, right.outflow[v])};
    set_vertex(field, v, rule.kind == FibreRuleKind::bayer ? bayer_frame(p) : doste_frame(p));
  }
}

// ---- atria -----------------------------------------------------------------------------------------------

// Falls apart a set of vertices along the edges of a volume's cells: the rings of the single veins.
std::vector<Vertices> connected_parts(const TetMesh& mesh, int volume, const Vertices& vertices) {
  std::vector<int> parent(mesh.points.size(), -1);
  for (int v : vertices) parent[at(v)] = v;
  const auto root = [&](int v) {
    while (parent[at(v)] != v) v = parent[at(v)] = parent[at(parent[at(v)])];
    return v;
  };
  for (std::size_t c = 0; c < mesh.cells.size(); ++c)
    if (mesh.cell_tags[c] == volume)
      for (int a : mesh.cells[c])
        for (int b : mesh.cells[c])
          if (parent[at(a)] >= 0 && parent[at(b)] >= 0) parent[at(root(a))] = root(b);
  std::map<int, Vertices> parts;
  for (int v : vertices) parts[root(v)].push_back(v);
  std::vector<Vertices> result;
  for (auto& [key, part] : parts) result.push_back(std::move(part));
  return result;
}

// Vein rings sorted into the two groups that atrial bundles run between; empty where they cannot be told.
// Left atrium: first the left, then the right pulmonary veins. Right atrium: superior, inferior vena cava.
std::array<Vertices, 2> vein_groups(const Surfaces& surfaces, int volume, bool is_left,
                                    const Vertices& veins) {
  using namespace mesh_tags;
  const TetMesh& mesh = surfaces.mesh;
  std::vector<Vertices> parts = connected_parts(mesh, volume, veins);
  const auto has = [&](int tag) {
    return std::find(mesh.cell_tags.begin(), mesh.cell_tags.end(), tag) != mesh.cell_tags.end();
  };
  const int landmark = is_left ? right_atrium : ventricles;
  if (parts.size() < 2 || (!is_left && parts.size() != 2) || landmark == volume || !has(landmark)) return {};
  // The right pulmonary veins lie towards the right atrium, the inferior cava towards the ventricles.
  const Point3 away = centroid_of_cells(mesh, volume) - centroid_of_cells(mesh, landmark);
  std::sort(parts.begin(), parts.end(), [&](const Vertices& a, const Vertices& b) {
    return dot(centroid(mesh, a), away) > dot(centroid(mesh, b), away);
  });
  std::array<Vertices, 2> groups;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    Vertices& group = groups[i < parts.size() / 2 ? 0 : 1];
    group = joined(group, parts[i]);
  }
  return groups;
}

void add_atrium(const Surfaces& surfaces, int volume, FibreField& field) {
  using namespace mesh_tags;
  const TetMesh& mesh = surfaces.mesh;
  const LaplaceProblem problem(mesh, {volume});
  const Vertices endo_left = surfaces.on({endocardium_LA}, volume),
                 endo_right = surfaces.on({endocardium_RA}, volume);
  const BoundarySet inside{
      fmt::format("endocardium (surface {} or {}) of volume {}", endocardium_RA, endocardium_LA, volume),
      joined(endo_left, endo_right)};
  const BoundarySet outside{fmt::format("epicardium (surface {} or {}) of volume {}", mesh_tags::epicardium,
                                        epicardium_fat, volume),
                            surfaces.on({mesh_tags::epicardium, epicardium_fat}, volume)};
  const BoundarySet annulus{fmt::format("annulus (volumes {}, {} next to volume {})", annuli, valves, volume),
                            surfaces.shared(volume, [](int tag) { return tag == annuli || tag == valves; })};
  const Vertices veins =
      joined(surfaces.shared(volume, [](int tag) { return tag == caps; }), surfaces.on({rings}, volume));
  BoundarySet roof{"vein rings", veins};
  if (veins.empty()) {
    const Point3 middle = centroid(mesh, annulus.vertices);
    int farthest = inside.vertices.empty() ? 0 : inside.vertices[0];
    for (int v : inside.vertices)
      if (norm(mesh.points[at(v)] - middle) > norm(mesh.points[at(farthest)] - middle)) farthest = v;
    roof = {"roof", {farthest}};
  }
  const auto phi = problem.solve(std::vector{inside, outside}, {1, 0});
  const auto psi_roof = problem.solve(std::vector{annulus, roof}, {1, 0});

  // Thresholds: fibres.md after Piersanti et al.; psi_veins is 0 on the first group, 1 on the second one.
  const bool is_left = !endo_left.empty();
  const bool one_chamber = endo_left.empty() || endo_right.empty();
  const auto groups = one_chamber ? vein_groups(surfaces, volume, is_left, veins) : std::array<Vertices, 2>{};
  const bool bundles = !groups[0].empty();
  const double vestibule = is_left ? 0.65 : 0.9, first = is_left ? 0.35 : 0.1, second = 0.9;
  std::vector<double> psi_veins, psi_wall;
  if (bundles) {
    const BoundarySet a{"first veins", groups[0]}, b{"second veins", groups[1]};
    psi_veins = problem.solve(std::vector{a, b}, {0, 1});
    psi_wall = problem.solve(std::vector{a, b, annulus}, {0, 2, 1});
  }
  const auto transmural = problem.vertex_gradients(phi), to_annulus = problem.vertex_gradients(psi_roof);
  const auto between = bundles ? problem.vertex_gradients(psi_veins) : std::vector<Point3>{};
  const auto along = bundles ? problem.vertex_gradients(psi_wall) : std::vector<Point3>{};
  for (std::size_t v = 0; v < mesh.points.size(); ++v) {
    check_interrupt();
    if (!problem.in_region(static_cast<int>(v))) continue;
    Point3 longitudinal = to_annulus[v];
    if (bundles && psi_roof[v] < vestibule)
      longitudinal = psi_veins[v] <= first || psi_veins[v] >= second ? between[v] : along[v];
    set_vertex(field, v, wall_frame(longitudinal, -1.0 * transmural[v], 0, 0));
    field.transmural[v] = phi[v];
    field.apex_base[v] = psi_roof[v];
  }
}

FibreField empty_field(const TetMesh& mesh) {
  const std::size_t n = mesh.points.size();
  FibreField field;
  field.frames.assign(n, Frame{});
  field.axes.assign(n, Frame{});
  field.alpha_deg.assign(n, 0);
  field.beta_deg.assign(n, 0);
  field.transmural.assign(n, 0);
  field.endocardial_distance.assign(n, 1);
  field.interventricular.assign(n, 1);
  field.apex_base.assign(n, 0);
  return field;
}

bool is_zero(const Frame& frame) { return dot(frame[0], frame[0]) == 0; }

// The line nearest to a bundle of lines: main direction of the sum of weighted dyads.
Point3 main_direction(const Eigen::Matrix3d& dyads) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(dyads);
  const Eigen::Vector3d v = solver.eigenvectors().col(2);
  return {v[0], v[1], v[2]};
}

}  // namespace

Frame turned_frame(const Frame& axes, double alpha_deg, double beta_deg) {
  const auto& [e_l, e_n, e_t] = axes;
  const double alpha = alpha_deg * radian_per_deg, beta = beta_deg * radian_per_deg;
  const Point3 f = std::cos(alpha) * e_l + std::sin(alpha) * e_n;
  const Point3 in_wall = std::cos(alpha) * e_n - std::sin(alpha) * e_l;
  return orthonormalized(f, std::cos(beta) * e_t + std::sin(beta) * in_wall);
}

FibreRule fibre_rule(FibreRuleKind kind, const std::array<double, 16>& angles) {
  for (std::size_t i = 0; i < angles.size(); ++i) check_range(fibre_quantities[i], angles[i], "fibre rule");
  const auto four = [&](std::size_t i) {
    return FibreAngles{angles[i], angles[i + 1], angles[i + 2], angles[i + 3]};
  };
  return {kind, four(0), four(4), four(8), four(12)};
}

FibreRuleKind fibre_rule_kind(std::string_view name) {
  if (name == "bayer") return FibreRuleKind::bayer;
  if (name == "doste") return FibreRuleKind::doste;
  refuse_unknown("fibre rule", name, std::vector<std::string>{"bayer", "doste"});
}

FibreField rule_based_fibres(const TetMesh& mesh, const FibreRule& rule) {
  FibreField field = empty_field(mesh);
  const Surfaces surfaces(mesh);
  const auto has = [&](int tag) {
    return std::find(mesh.cell_tags.begin(), mesh.cell_tags.end(), tag) != mesh.cell_tags.end();
  };
  if (!has(mesh_tags::ventricles) && !has(mesh_tags::left_atrium) && !has(mesh_tags::right_atrium))
    throw InputError("fibres: the mesh has no myocardium (volumes 1, 2 or 3)");
  if (has(mesh_tags::ventricles)) add_ventricles(surfaces, rule, field);
  if (has(mesh_tags::left_atrium)) add_atrium(surfaces, mesh_tags::left_atrium, field);
  if (has(mesh_tags::right_atrium)) add_atrium(surfaces, mesh_tags::right_atrium, field);
  return field;
}

FibreField fibres_from_cells(const TetMesh& mesh) {
  if (mesh.cell_frames.size() != mesh.cells.size())
    throw InputError(
        fmt::format("fibres: the mesh brings {} fibre directions for {} cells; it must bring one a cell",
                    mesh.cell_frames.size(), mesh.cells.size()));
  FibreField field = rule_based_fibres(mesh);
  field.alpha_deg.clear();  // the file's lines have none
  field.beta_deg.clear();
  field.cell_frames.assign(mesh.cells.size(), Frame{});
  std::vector<Eigen::Matrix3d> fibres(mesh.points.size(), Eigen::Matrix3d::Zero()), sheets = fibres;
  for (std::size_t c = 0; c < mesh.cells.size(); ++c) {
    if (!mesh_tags::conductive(mesh.cell_tags[c])) continue;
    const Frame& given = mesh.cell_frames[c];
    if (!(norm(given[0]) > 0))
      throw InputError(
          fmt::format("fibres: cell {} is myocardium (volume {}), but the mesh gives it no fibre direction",
                      c, mesh.cell_tags[c]));
    field.cell_frames[c] = orthonormalized(given[0], given[1]);
    const double volume = cell_geometry(mesh, static_cast<int>(c)).volume;
    const Eigen::Vector3d f = to_eigen(field.cell_frames[c][0]), s = to_eigen(field.cell_frames[c][1]);
    for (int v : mesh.cells[c]) {
      fibres[at(v)] += volume * f * f.transpose();
      sheets[at(v)] += volume * s * s.transpose();
    }
  }
  for (std::size_t v = 0; v < mesh.points.size(); ++v)
    if (!is_zero(field.frames[v]))
      field.frames[v] = orthonormalized(main_direction(fibres[v]), main_direction(sheets[v]));
  return field;
}

Frame frame_at(const FibreField& field, const TetMesh& mesh, int cell,
               const std::array<double, 4>& barycentric) {
  if (!mesh_tags::conductive(mesh.cell_tags[at(cell)])) return {};
  if (!field.cell_frames.empty()) return field.cell_frames[at(cell)];
  const auto& vertices = mesh.cells[at(cell)];
  const bool has_angles = !field.alpha_deg.empty();
  const std::vector<Frame>& lines = has_angles ? field.axes : field.frames;
  std::array<Eigen::Quaterniond, 4> q;
  for (std::size_t i = 0; i < 4; ++i) q[i] = Eigen::Quaterniond(to_rotation(lines[at(vertices[i])]));

  // Signs are those of the vertex that the others are nearest to. It belongs to the cell, not to the point:
  // then the sum is linear in the cell, and as each term is within a right angle of it, it vanishes nowhere.
  std::size_t centre = 0;
  double most = -1;
  for (std::size_t i = 0; i < 4; ++i) {
    double sum = 0;
    for (std::size_t k = 0; k < 4; ++k) sum += nearest_half_turn(q[i], q[k]).second;
    if (sum > most + 1e-12) {
      most = sum;
      centre = i;
    }
  }
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  double alpha_deg = 0, beta_deg = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const std::size_t turn = nearest_half_turn(q[centre], q[i]).first;
    const Eigen::Quaterniond aligned = q[i] * half_turns()[turn];
    sum += (aligned.dot(q[centre]) < 0 ? -1.0 : 1.0) * barycentric[i] * aligned.coeffs();
    if (!has_angles) continue;
    // Seen from axes turned half round e_l, e_n or e_t, the same lines have angles of these signs.
    constexpr double of_alpha[] = {1, -1, -1, 1}, of_beta[] = {1, 1, -1, -1};
    alpha_deg += barycentric[i] * of_alpha[turn] * field.alpha_deg[at(vertices[i])];
    beta_deg += barycentric[i] * of_beta[turn] * field.beta_deg[at(vertices[i])];
  }
  const Frame between = to_frame(Eigen::Quaterniond(sum).normalized().toRotationMatrix());
  return has_angles ? turned_frame(between, alpha_deg, beta_deg) : between;
}

double helix_angle_deg(const Point3& fibre, const Point3& outward, const Point3& axis) {
  const Point3 e_t = normalized(outward), e_n = orthogonal_part(axis, e_t), e_l = cross(e_n, e_t);
  const double angle = std::atan2(dot(fibre, e_n), dot(fibre, e_l)) / radian_per_deg;
  return angle > 90 ? angle - 180 : angle <= -90 ? angle + 180 : angle;
}

bool FibreCheck::good() const {
  return sizes_match && coordinates_in_range && vertices_missing == 0 && vertices_superfluous == 0 &&
         vertices_with_frame > 0 && worst_length <= tolerance && worst_orthogonality <= tolerance &&
         worst_handedness <= tolerance;
}

FibreCheck check_fibres(const TetMesh& mesh, const FibreField& field) {
  FibreCheck check;
  const std::size_t n = mesh.points.size();
  const std::array<const std::vector<double>*, 4> coordinates = {
      &field.transmural, &field.endocardial_distance, &field.interventricular, &field.apex_base};
  const std::size_t n_angles = field.alpha_deg.empty() ? 0 : n;
  check.sizes_match =
      field.frames.size() == n && field.axes.size() == n && field.alpha_deg.size() == n_angles &&
      field.beta_deg.size() == n_angles &&
      std::all_of(coordinates.begin(), coordinates.end(), [&](const auto* c) { return c->size() == n; });
  if (!check.sizes_match) return check;
  check.coordinates_in_range = std::all_of(coordinates.begin(), coordinates.end(), [](const auto* c) {
    return std::all_of(c->begin(), c->end(), [](double x) { return x >= 0 && x <= 1; });
  });
  const auto myocardium = vertices_of_cells(mesh, mesh_tags::conductive);
  // std::max drops a NaN in its second argument; a frame with one must not pass.
  const auto worse = [](double& worst, double value) {
    worst = value <= worst ? worst : std::isnan(value) ? unbounded : value;
  };
  for (std::size_t v = 0; v < n; ++v) {
    check_interrupt();
    const auto& [f, s, normal] = field.frames[v];
    if (is_zero(field.frames[v]) != (myocardium[v] == 0))
      ++(myocardium[v] ? check.vertices_missing : check.vertices_superfluous);
    if (is_zero(field.frames[v])) continue;
    ++check.vertices_with_frame;
    for (const Point3* d : {&f, &s, &normal}) worse(check.worst_length, std::abs(norm(*d) - 1));
    for (double cosine : {dot(f, s), dot(f, normal), dot(s, normal)})
      worse(check.worst_orthogonality, std::abs(cosine));
    worse(check.worst_handedness, std::abs(dot(cross(f, s), normal) - 1));
  }
  return check;
}

std::vector<HelixRow> helix_table(const TetMesh& mesh, const FibreField& field) {
  const auto ventricle = vertices_of_cells(mesh, [](int tag) { return tag == mesh_tags::ventricles; });
  const Vertices all = select_vertices(ventricle, [](int) { return true; });
  if (all.empty()) return {};
  const LaplaceProblem problem(mesh, {mesh_tags::ventricles});
  const auto inwards = problem.vertex_gradients(field.transmural),
             upwards = problem.vertex_gradients(field.apex_base);
  const Point3 axis = direction_of_base(mesh, ventricular_sets(Surfaces(mesh)).base);
  const auto height = [&](int v) { return dot(mesh.points[at(v)], axis); };
  const auto [bottom, top] =
      std::minmax_element(all.begin(), all.end(), [&](int a, int b) { return height(a) < height(b); });
  const double low = height(*bottom), high = height(*top);

  // Angles of lines: the mean is taken of doubled angles, so that -89 and +89 average to 90.
  struct Sum {
    double cosine = 0, sine = 0;
    std::size_t n = 0;
    double mean() const {
      if (n == 0) return std::numeric_limits<double>::quiet_NaN();
      const double angle = std::atan2(sine, cosine) / 2 / radian_per_deg;
      return angle < -88 ? angle + 180 : angle;
    }
  };
  std::array<std::array<Sum, 3>, 2> sums;
  for (int v : all) {
    const double fraction = (height(v) - low) / (high - low), depth = field.transmural[at(v)];
    const double xi = field.interventricular[at(v)];
    const int band = depth >= 0.9 ? 0 : depth <= 0.1 ? 2 : depth >= 0.4 && depth <= 0.6 ? 1 : -1;
    if (fraction < 0.2 || fraction > 0.8 || band < 0 || (xi > 0.05 && xi < 0.95)) continue;
    if (norm(inwards[at(v)]) == 0) continue;
    const double angle =
        2 * radian_per_deg * helix_angle_deg(field.frames[at(v)][0], -1.0 * inwards[at(v)], upwards[at(v)]);
    Sum& sum = sums[xi >= 0.95 ? 0 : 1][at(band)];
    sum.cosine += std::cos(angle);
    sum.sine += std::sin(angle);
    ++sum.n;
  }
  std::vector<HelixRow> rows;
  for (std::size_t side = 0; side < 2; ++side) {
    const auto& s = sums[side];
    if (s[0].n + s[1].n + s[2].n > 0)
      rows.push_back({side == 0 ? "left ventricle" : "right ventricle",
                      s[0].mean(),
                      s[1].mean(),
                      s[2].mean(),
                      {s[0].n, s[1].n, s[2].n}});
  }
  return rows;
}

}  // namespace wiggers
