// A tetrahedral mesh as plain numbers: what is read, made, checked and handed to everything else.
//
// The order of points and cells is the file's and does not depend on the number of processes: fields and
// checkpoints are stored in it.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

namespace wiggers {

using Point3 = std::array<double, 3>;

struct TetMesh {
  std::vector<Point3> points;              // m
  std::vector<std::array<int, 4>> cells;   // positively oriented: (b - a) x (c - a) . (d - a) > 0
  std::vector<int> cell_tags;              // one a cell, see mesh_tags
  std::vector<std::array<int, 3>> facets;  // tagged boundary triangles, normal out of the tissue
  std::vector<int> facet_tags;             // one a facet
  // Fibre, sheet and sheet-normal direction of each cell, where a file brought them; else empty.
  std::vector<std::array<Point3, 3>> cell_frames;
};

namespace mesh_tags {
// Volumes.
inline constexpr int ventricles = 1, left_atrium = 2, right_atrium = 3, annuli = 5, valves = 6, aorta = 7,
                     pulmonary_trunk = 8, caps = 9;
// Surfaces. The four endocardia are closed: each includes the chamber's side of valve discs and caps.
inline constexpr int endocardium_RA = 21, endocardium_LA = 22, endocardium_RV = 23, endocardium_LV = 24;
inline constexpr int endothelium_aorta = 25, endothelium_pulmonary_trunk = 26;
inline constexpr int epicardium = 31;      // towards pericardial fluid
inline constexpr int epicardium_fat = 32;  // towards fat; the base of a lone ventricle
inline constexpr int arterial_outside = 33;
inline constexpr int rings = 40;  // cut ends of veins and arteries

struct Tag {
  int tag;
  std::string_view name;
  std::string_view meaning;
};
inline constexpr std::array<Tag, 8> volumes = {{
    {ventricles, "ventricles", "ventricular myocardium"},
    {left_atrium, "left-atrium", "left atrial myocardium"},
    {right_atrium, "right-atrium", "right atrial myocardium"},
    {annuli, "annuli", "fibrous plate of the valve annuli"},
    {valves, "valves", "closed valve discs"},
    {aorta, "aorta", "wall of the aorta"},
    {pulmonary_trunk, "pulmonary-trunk", "wall of the pulmonary trunk"},
    {caps, "caps", "caps that close veins or a truncated base"},
}};
inline constexpr std::array<Tag, 10> surfaces = {{
    {endocardium_RA, "endocardium-RA", "inner surface of the right atrium, closed"},
    {endocardium_LA, "endocardium-LA", "inner surface of the left atrium, closed"},
    {endocardium_RV, "endocardium-RV", "inner surface of the right ventricle, closed"},
    {endocardium_LV, "endocardium-LV", "inner surface of the left ventricle, closed"},
    {endothelium_aorta, "endothelium-aorta", "inner surface of the aorta"},
    {endothelium_pulmonary_trunk, "endothelium-pulmonary-trunk", "inner surface of the pulmonary trunk"},
    {epicardium, "epicardium", "outer surface towards pericardial fluid"},
    {epicardium_fat, "base", "outer surface towards fat: ventricular base, lower appendages"},
    {arterial_outside, "arterial-outside", "outer surface of the arteries"},
    {rings, "rings", "cut ends of veins and arteries"},
}};

template <std::size_t N>
constexpr std::string_view name_of_tag(const std::array<Tag, N>& tags, int tag) {
  for (const Tag& known : tags)
    if (known.tag == tag) return known.name;
  return "?";
}

// Electrically active: the myocardium.
constexpr bool conductive(int volume_tag) {
  return volume_tag == ventricles || volume_tag == left_atrium || volume_tag == right_atrium;
}
}  // namespace mesh_tags

}  // namespace wiggers
