#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/check.hpp>
#include <wiggers/tissue/mesh/geometry.hpp>

namespace wiggers {

namespace {

using Severity = MeshFinding::Severity;
constexpr double closed_gap = 1e-10;
constexpr double poor_quality = 0.1, hopeless_quality = 1e-5;

bool is_endocardium(int tag) { return tag >= mesh_tags::endocardium_RA && tag <= mesh_tags::endocardium_LV; }

template <class Tags>
bool is_known(const Tags& tags, int tag) {
  return std::any_of(tags.begin(), tags.end(), [&](const auto& t) { return t.tag == tag; });
}
template <class Tags>
std::string with_name(const Tags& tags, int tag) {
  for (const auto& t : tags)
    if (t.tag == tag) return fmt::format("{} ({})", tag, t.name);
  return std::to_string(tag);
}
std::string surface_name(int tag) { return with_name(mesh_tags::surfaces, tag); }
std::string volume_name(int tag) { return with_name(mesh_tags::volumes, tag); }

const Point3& point(const TetMesh& mesh, int p) { return mesh.points[static_cast<std::size_t>(p)]; }
std::string mm_text(const Point3& mm) { return place_text(1e-3 * mm); }

struct Edge {
  int low, high;
  friend bool operator==(const Edge&, const Edge&) = default;
  friend auto operator<=>(const Edge&, const Edge&) = default;
};

std::vector<Edge> sorted_edges(const std::vector<std::array<int, 3>>& triangles) {
  std::vector<Edge> edges;
  for (const auto& t : triangles)
    for (std::size_t k = 0; k < 3; ++k) {
      const int a = t[k], b = t[(k + 1) % 3];
      edges.push_back({std::min(a, b), std::max(a, b)});
    }
  std::sort(edges.begin(), edges.end());
  return edges;
}

// Calls f(edge, how often it stands in the list).
template <class F>
void count_equal(const std::vector<Edge>& edges, const F& f) {
  for (std::size_t i = 0; i < edges.size();) {
    std::size_t k = i;
    while (k < edges.size() && edges[k] == edges[i]) ++k;
    f(edges[i], k - i);
    i = k;
  }
}

class Check {
 public:
  explicit Check(const TetMesh& mesh) : mesh_(mesh) {}

  MeshReport run() {
    count();
    volumes();
    surfaces();
    shapes();
    boundary();
    coincident();
    parts();
    thickness();
    std::stable_sort(r_.findings.begin(), r_.findings.end(), [](const MeshFinding& a, const MeshFinding& b) {
      return a.severity == Severity::error && b.severity == Severity::warning;
    });
    return std::move(r_);
  }

 private:
  void find(Severity severity, std::string text, std::string remedy) {
    r_.findings.push_back({severity, std::move(text), std::move(remedy)});
  }

  void count() {
    r_.points = mesh_.points.size();
    r_.cells = mesh_.cells.size();
    r_.facets = mesh_.facets.size();
    if (mesh_.points.empty() || mesh_.cells.empty()) {
      find(Severity::error, "the mesh is empty", "mesh the volumes");
      return;
    }
    Point3 low = mesh_.points.front(), high = low;
    for (const Point3& x : mesh_.points)
      for (std::size_t k = 0; k < 3; ++k) {
        low[k] = std::min(low[k], x[k]);
        high[k] = std::max(high[k], x[k]);
      }
    r_.extent_mm = 1e3 * (high - low);
    const double longest = *std::max_element(r_.extent_mm.begin(), r_.extent_mm.end());
    // A mouse's heart measures 8 mm, a whale's 1 m; what is far from both is in another unit.
    // A sample of tissue without cavities may have any size.
    const bool hollow = std::any_of(mesh_.facet_tags.begin(), mesh_.facet_tags.end(), [](int tag) {
      return tag >= mesh_tags::endocardium_RA && tag <= mesh_tags::endocardium_LV;
    });
    const bool impossible = hollow && (longest < 2 || longest > 700);
    if (longest < 5 || longest > 400)
      find(impossible ? Severity::error : Severity::warning,
           fmt::format("the mesh measures {:.4g} mm, no size of a heart", longest),
           "give the unit of the file");
  }

  void volumes() {
    std::map<int, MeshVolume> by_tag;
    for (std::size_t c = 0; c < mesh_.cells.size(); ++c) {
      MeshVolume& v = by_tag[mesh_.cell_tags[c]];
      v.tag = mesh_.cell_tags[c];
      ++v.cells;
      v.volume_mL += 1e6 * cell_volume(mesh_, c);
    }
    for (const auto& [tag, v] : by_tag) {
      r_.volumes.push_back(v);
      if (!is_known(mesh_tags::volumes, tag))
        find(Severity::error,
             fmt::format("{} cells have the volume tag {}, which means nothing", v.cells, tag),
             "known volume tags: 1 ventricles, 2 and 3 left and right atrium, 5 annuli, 6 valves, 7 aorta, "
             "8 pulmonary trunk, 9 caps");
    }
  }

  void surfaces() {
    std::map<int, std::vector<std::array<int, 3>>> by_tag;
    std::map<int, Point3> sum;
    std::map<int, double> area;
    for (std::size_t f = 0; f < mesh_.facets.size(); ++f) {
      const int tag = mesh_.facet_tags[f];
      const Point3 a = facet_area_vector(mesh_, f);
      by_tag[tag].push_back(mesh_.facets[f]);
      sum[tag] = sum[tag] + a;
      area[tag] += norm(a);
    }
    for (const auto& [tag, triangles] : by_tag) {
      MeshSurface s;
      s.tag = tag;
      s.facets = triangles.size();
      s.area_cm2 = 1e4 * area[tag];
      s.gap = norm(sum[tag]) / area[tag];
      count_equal(sorted_edges(triangles), [&](const Edge& e, std::size_t times) {
        if (times == 2) return;
        if (s.open_edges++ == 0) s.first_open_edge_mm = 500.0 * (point(mesh_, e.low) + point(mesh_, e.high));
      });
      s.closed = s.open_edges == 0 && s.gap <= closed_gap;
      s.enclosed_mL = s.closed ? 1e6 * enclosed_volume(mesh_, tag) : 0;
      r_.surfaces.push_back(s);
      judge(s);
    }
  }

  void judge(const MeshSurface& s) {
    if (!is_known(mesh_tags::surfaces, s.tag))
      find(Severity::warning,
           fmt::format("{} triangles have the surface tag {}, which means nothing", s.facets, s.tag),
           "they are free of load; known surface tags: 21 to 24 endocardium RA, LA, RV, LV, 25 and 26 "
           "endothelium of "
           "aorta and pulmonary trunk, 31 epicardium, 32 base, 33 arterial outside, 40 rings");
    if (!is_endocardium(s.tag)) return;
    if (!s.closed)
      find(Severity::error,
           fmt::format(
               "surface {} is not closed: {} edges belong to not exactly two of its triangles, the first at "
               "{}; sum of N dA {:.1e} of the area",
               surface_name(s.tag), s.open_edges, mm_text(s.first_open_edge_mm), s.gap),
           "tag the chamber's side of valves and caps as this endocardium too; without them, make some");
    else if (s.enclosed_mL <= 0)
      find(Severity::error,
           fmt::format("surface {} encloses tissue, not a cavity ({} mL)", surface_name(s.tag),
                       figure_text(s.enclosed_mL, 1)),
           "tag the inner surface as endocardium and the outer one as epicardium (31)");
  }

  void shapes() {
    if (mesh_.cells.empty()) return;
    std::vector<double> quality(mesh_.cells.size());
    double sum = 0;
    r_.smallest_angle_deg = 180;
    for (std::size_t c = 0; c < quality.size(); ++c) {
      quality[c] = cell_quality(mesh_, c);
      sum += quality[c];
      if (quality[c] < quality[r_.worst_cell]) r_.worst_cell = c;
      r_.smallest_angle_deg = std::min(r_.smallest_angle_deg, smallest_dihedral_angle_deg(mesh_, c));
    }
    r_.mean_quality = sum / static_cast<double>(quality.size());
    r_.lowest_quality = quality[r_.worst_cell];
    r_.worst_tag = mesh_.cell_tags[r_.worst_cell];
    r_.worst_place_mm = 1e3 * cell_centre(mesh_, r_.worst_cell);
    const auto percent = quality.begin() + static_cast<std::ptrdiff_t>(quality.size() / 100);
    std::nth_element(quality.begin(), percent, quality.end());
    r_.quality_of_worst_percent = *percent;
    if (r_.lowest_quality < poor_quality)
      find(r_.lowest_quality < hopeless_quality ? Severity::error : Severity::warning,
           fmt::format("lowest quality {:.2g}: cell {} of volume {} at {}", r_.lowest_quality, r_.worst_cell,
                       volume_name(r_.worst_tag), mm_text(r_.worst_place_mm)),
           "flat cells make the mechanics slow or fail; optimise the mesh (gmsh -optimize), or change the "
           "size");
  }

  void boundary() {
    const auto outer = outer_triangles(mesh_.cells);
    std::vector<std::array<int, 3>> tagged, all;
    for (const auto& facet : mesh_.facets) tagged.push_back(ascending(facet));
    std::sort(tagged.begin(), tagged.end());
    Point3 place{};
    for (const OuterTriangle& t : outer) {
      all.push_back(t.corners);
      if (std::binary_search(tagged.begin(), tagged.end(), ascending(t.corners))) continue;
      if (r_.untagged_triangles++ == 0)
        place = (1.0 / 3) *
                (point(mesh_, t.corners[0]) + point(mesh_, t.corners[1]) + point(mesh_, t.corners[2]));
    }
    if (r_.untagged_triangles > 0)
      find(Severity::warning,
           fmt::format("{} of {} outer triangles have no tag, the first at {}", r_.untagged_triangles,
                       outer.size(), place_text(place)),
           "they are free of load; tag them if they belong to a surface");
    Point3 hinge{};
    count_equal(sorted_edges(all), [&](const Edge& e, std::size_t times) {
      if (times > 2 && r_.hinges++ == 0) hinge = 0.5 * (point(mesh_, e.low) + point(mesh_, e.high));
    });
    if (r_.hinges > 0)
      find(Severity::warning,
           fmt::format("{} edges where the tissue hangs together by the edge alone, the first at {}",
                       r_.hinges, place_text(hinge)),
           "such hinges have no stiffness; thicken the tissue there");
  }

  void coincident() {
    std::vector<std::size_t> order(mesh_.points.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::sort(order.begin(), order.end(),
              [&](std::size_t a, std::size_t b) { return mesh_.points[a] < mesh_.points[b]; });
    Point3 place{};
    for (std::size_t i = 1; i < order.size(); ++i)
      if (mesh_.points[order[i]] == mesh_.points[order[i - 1]] && r_.coincident_points++ == 0)
        place = mesh_.points[order[i]];
    if (r_.coincident_points > 0)
      find(
          Severity::error,
          fmt::format("{} points lie exactly at another's place, the first at {}: parts are not joined there",
                      r_.coincident_points, place_text(place)),
          "merge double points (gmsh: Coherence Mesh; ParaView: Clean to Grid)");
  }

  // Pieces of the cells for which `wanted` holds that hang together by faces.
  template <class Wanted>
  int pieces(const std::vector<CellFace>& faces, const Wanted& wanted) {
    std::vector<int> root(mesh_.cells.size());
    std::iota(root.begin(), root.end(), 0);
    const auto find_root = [&](int c) {
      while (root[static_cast<std::size_t>(c)] != c)
        c = root[static_cast<std::size_t>(c)] =
            root[static_cast<std::size_t>(root[static_cast<std::size_t>(c)])];
      return c;
    };
    int count = 0;
    for (const int tag : mesh_.cell_tags) count += wanted(tag);
    for (std::size_t i = 1; i < faces.size(); ++i) {
      const int a = faces[i].cell, b = faces[i - 1].cell;
      if (faces[i].corners != faces[i - 1].corners || !wanted(mesh_.cell_tags[static_cast<std::size_t>(a)]) ||
          !wanted(mesh_.cell_tags[static_cast<std::size_t>(b)]))
        continue;
      const int x = find_root(a), y = find_root(b);
      if (x == y) continue;
      root[static_cast<std::size_t>(std::max(x, y))] = std::min(x, y);
      --count;
    }
    return count;
  }

  // Two cells at one face lie on either side of it; on one side they overlap, whatever their orientation.
  void overlaps(const std::vector<CellFace>& faces) {
    const auto apex = [&](const CellFace& face) {
      return mesh_.cells[static_cast<std::size_t>(face.cell)][static_cast<std::size_t>(face.opposite)];
    };
    std::size_t overlapping = 0, crowded = 0;
    Point3 place{};
    for (std::size_t i = 1; i < faces.size(); ++i) {
      if (faces[i].corners != faces[i - 1].corners) continue;
      if (i > 1 && faces[i].corners == faces[i - 2].corners) ++crowded;
      const Point3 a = point(mesh_, faces[i].corners[0]), b = point(mesh_, faces[i].corners[1]),
                   c = point(mesh_, faces[i].corners[2]);
      const Point3 normal = cross(b - a, c - a);
      const double one = dot(normal, point(mesh_, apex(faces[i])) - a),
                   other = dot(normal, point(mesh_, apex(faces[i - 1])) - a);
      if (one * other > 0 && overlapping++ == 0) place = (1.0 / 3) * (a + b + c);
    }
    if (overlapping + crowded > 0)
      find(Severity::error,
           fmt::format("the mesh is tangled: {} pairs of cells overlap at their common face{}{}", overlapping,
                       overlapping > 0 ? ", the first at " + place_text(place) : "",
                       crowded > 0 ? fmt::format("; {} faces belong to more than two cells", crowded) : ""),
           "what overlaps counts twice; mesh the volume anew");
  }

  void parts() {
    const auto ventricular = [](int tag) { return tag == mesh_tags::ventricles; };
    const auto atrial = [](int tag) {
      return tag == mesh_tags::left_atrium || tag == mesh_tags::right_atrium;
    };
    const auto faces = sorted_faces(mesh_.cells);
    overlaps(faces);
    r_.ventricular_pieces = pieces(faces, ventricular);
    r_.atrial_pieces = pieces(faces, atrial);
    if (r_.ventricular_pieces > 1)
      find(Severity::warning,
           fmt::format("the ventricular myocardium (1) is in {} pieces", r_.ventricular_pieces),
           "excitation does not pass between them; stimulate each");
    std::vector<char> kinds(mesh_.points.size(), 0);
    for (std::size_t c = 0; c < mesh_.cells.size(); ++c)
      for (const int p : mesh_.cells[c])
        kinds[static_cast<std::size_t>(p)] |= static_cast<char>(ventricular(mesh_.cell_tags[c]) ? 1
                                                                : atrial(mesh_.cell_tags[c])    ? 2
                                                                                                : 0);
    const auto both = static_cast<std::size_t>(std::count(kinds.begin(), kinds.end(), char{3}));
    if (both == 0) return;
    const auto first =
        static_cast<std::size_t>(std::find(kinds.begin(), kinds.end(), char{3}) - kinds.begin());
    find(Severity::error,
         fmt::format("atria (2, 3) and ventricles (1) share {} points, the first at {}", both,
                     place_text(mesh_.points[first])),
         "they must be insulated from each other: put a layer of cells with tag 5 (annuli) between them");
  }

  // Linear displacements have one strain in an element: with one across, the wall's two sides have the same.
  void thickness() {
    std::vector<std::set<int>> sides(mesh_.points.size());
    for (std::size_t f = 0; f < mesh_.facets.size(); ++f) {
      const int tag = mesh_.facet_tags[f];
      if (is_endocardium(tag) || tag == mesh_tags::epicardium)
        for (const int p : mesh_.facets[f]) sides[static_cast<std::size_t>(p)].insert(tag);
    }
    std::size_t conductive = 0, thin = 0;
    Point3 place{};
    for (std::size_t c = 0; c < mesh_.cells.size(); ++c) {
      if (!mesh_tags::conductive(mesh_.cell_tags[c])) continue;
      ++conductive;
      bool through = false;
      for (std::size_t i = 0; i < 4; ++i)
        for (std::size_t k = 0; k < i; ++k) {
          const auto& a = sides[static_cast<std::size_t>(mesh_.cells[c][i])];
          const auto& b = sides[static_cast<std::size_t>(mesh_.cells[c][k])];
          // Points of a rim belong to both surfaces and say nothing about the wall.
          if (a.size() == 1 && b.size() == 1 && *a.begin() != *b.begin()) through = true;
        }
      if (through && thin++ == 0) place = cell_centre(mesh_, c);
    }
    if (conductive == 0) return;
    r_.thin_share = static_cast<double>(thin) / static_cast<double>(conductive);
    if (thin > 0)
      find(Severity::warning,
           fmt::format(
               "{} cells of the myocardium ({:.3g} %) reach through the wall with one edge, the first at {}",
               static_cast<long>(thin), 100 * r_.thin_share, place_text(place)),
           "good enough for a draft, as fibres turn within cells; a finer mesh for what differs across the "
           "wall, "
           "and for volumes to a few per cent (docs/tissue.md)");
  }

  const TetMesh& mesh_;
  MeshReport r_;
};

}  // namespace

MeshReport check_mesh(const TetMesh& mesh) { return Check(mesh).run(); }

std::string report_text(const MeshReport& r) {
  std::string text = fmt::format("{} points, {} tetrahedra, {} tagged triangles; {} x {} x {} mm\n", r.points,
                                 r.cells, r.facets, figure_text(r.extent_mm[0], 1),
                                 figure_text(r.extent_mm[1], 1), figure_text(r.extent_mm[2], 1));
  for (const MeshVolume& v : r.volumes)
    text += fmt::format("  volume  {:<32} {:>8} cells   {:>9} mL\n", volume_name(v.tag), v.cells,
                        figure_text(v.volume_mL, 3));
  for (const MeshSurface& s : r.surfaces) {
    text += fmt::format("  surface {:<32} {:>8} facets  {:>9} cm2", surface_name(s.tag), s.facets,
                        figure_text(s.area_cm2, 3));
    text += s.closed ? fmt::format("   closed, {} {} mL\n", s.enclosed_mL > 0 ? "cavity" : "contains",
                                   figure_text(std::abs(s.enclosed_mL), 3))
                     : "   open\n";
  }
  text += fmt::format(
      "  quality (3 x inscribed / circumscribed radius): lowest {:.3f} in volume {} at {}, worst per cent "
      "below "
      "{:.3f}, mean {:.3f}; smallest angle {:.1f} deg\n",
      r.lowest_quality, volume_name(r.worst_tag), mm_text(r.worst_place_mm), r.quality_of_worst_percent,
      r.mean_quality, r.smallest_angle_deg);
  for (const MeshFinding& f : r.findings)
    text += fmt::format("  {}: {}. Remedy: {}\n", f.severity == Severity::error ? "ERROR" : "warning", f.text,
                        f.remedy);
  return text;
}

std::vector<std::string> require_sound(const TetMesh& mesh, std::span<const int> closed_cavities,
                                       std::string_view place) {
  const MeshReport report = check_mesh(mesh);
  std::vector<std::string> errors, warnings;
  for (const int tag : closed_cavities)
    if (std::none_of(report.surfaces.begin(), report.surfaces.end(),
                     [&](const MeshSurface& s) { return s.tag == tag; }))
      errors.push_back(fmt::format("no triangle has the surface tag {}", surface_name(tag)));
  for (const MeshFinding& f : report.findings)
    (f.severity == Severity::error ? errors : warnings)
        .push_back(fmt::format("{}. Remedy: {}", f.text, f.remedy));
  if (errors.empty()) return warnings;
  constexpr std::size_t shown = 3;
  std::string text = fmt::format("{}: the mesh cannot be used", place);
  for (std::size_t k = 0; k < std::min(shown, errors.size()); ++k) text += "\n  " + errors[k];
  if (errors.size() > shown)
    text += fmt::format("\n  and {} more: wiggers mesh check", errors.size() - shown);
  throw InputError(text);
}

}  // namespace wiggers
