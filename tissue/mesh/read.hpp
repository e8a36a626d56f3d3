// Mesh files: gmsh 2.2 and 4.1 (.msh, text and binary), VTK (.vtk text, .vtu uncompressed), CARP (.pts,
// .elem, .lon). What comes out is sound in itself: positive cells, no point unused, every facet a side of
// exactly one cell with its normal out of the tissue. Whether it fits a heart is told by check.hpp.
//
// Tags: gmsh's physical groups; the VTK cell array named tag, region or material (see mesh_read_vtk.cpp);
// CARP's region number. CARP has no tagged triangles: its facets stay empty.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

enum class MeshUnit { automatic, metre, centimetre, millimetre, micrometre };

// "auto", "m", "cm", "mm", "um"; refuses anything else.
MeshUnit mesh_unit(std::string_view name);

// The files that read_mesh(path) reads: one, or those of CARP that there are.
std::vector<std::filesystem::path> mesh_files(const std::filesystem::path& path);

// Reads by the name's ending; of CARP any of the three files, or their common name. The automatic unit is the
// one written by write_msh, else the format's (mm; CARP: um) if the mesh then measures 20 to 250 mm, else the
// first of mm, cm, m, um with which it does; the choice, and all that was mended, goes to `notes`.
// Throws ResourceError for a file that cannot be read and InputError for one that makes no sense.
TetMesh read_mesh(const std::filesystem::path& path, MeshUnit unit = MeshUnit::automatic,
                  std::vector<std::string>* notes = nullptr);

// gmsh 2.2 text in mm with the names of the tags; whole or not at all. Frames of cells are not stored.
void write_msh(const TetMesh& mesh, const std::filesystem::path& path);

}  // namespace wiggers
