// Places of a heart by their names in anatomy, found on any mesh from its tags alone.
//
// A ventricle's long axis runs from its apex, the endocardial vertex farthest from its base, to its base, the
// centroid of the vertices where its endocardium leaves the muscle (valves, annuli, a cap, an open rim).
// Around that axis the middle of the septum looks to the other ventricle, and anterior follows from the
// heart's handedness: with the axis u from apex to base and s towards the right ventricle, anterior is u x s
// of the left one. The sinus node lies in the right atrium where the superior caval vein opens into it, on
// the side away from the left atrium.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

struct Site {
  enum class Kind { apex, wall, sinus_node };
  Kind kind = Kind::sinus_node;
  bool right = false;    // of which ventricle
  double angle_deg = 0;  // around the axis: 0 middle of the septum, 90 anterior, 180 free wall, 270 posterior
  double height = 0.5;   // along the axis: 0 apex, 1 base
};

// "sinus-node", "LV-septum", "RV-free-wall", ...; what a scene may name.
const std::vector<std::string>& site_names();
// The site of one of these names; the height is for those of a wall.
Site named_site(std::string_view name, double height);
bool has_height(const Site& site);

// A vertex of the mesh: of the endocardium of its ventricle, of the right atrium's muscle. Refuses, in words,
// meshes without the parts that the site is found by.
Point3 find_site(const TetMesh& mesh, const Site& site);

// A ventricle's long axis.
struct LongAxis {
  Point3 base, apex;
  std::vector<int> ring;  // vertices whose centroid the base is
  int apex_vertex = 0;
};
// None where the mesh has no such ventricle, or it has no base.
std::optional<LongAxis> long_axis(const TetMesh& mesh, bool right);

}  // namespace wiggers
