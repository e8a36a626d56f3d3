// Fields on a mesh as files that ParaView (and every VTK reader) opens.
//
// One moment is one VTU file: XML with the arrays appended as raw bytes, written atomically. A series is a
// folder NAME.fields/ with frame_000000.vtu, frame_000001.vtu ... and index.pvd, which lists the frames with
// their times; open the index. The index is replaced atomically after each frame is on the disk, so a kill at
// any moment leaves a complete, readable series that ends with the last listed frame.
//
// Decided here:
// * Fields are stored in single precision (seven digits: plenty for pictures; restart files carry doubles).
//   Points (m) stay double. Values beyond the range of single precision become infinite.
// * Every frame repeats the mesh, because VTU knows no reference to another file: 24 bytes a point and 21
// bytes
//   a cell. A field costs 4 bytes a point and component.
// * Bytes are those of the machine (little-endian on all supported ones); the header says so.
#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// Values are not copied: what `values` points to must live until the writing function returns.
struct PointField {
  std::string name;                // with its unit: "potential_mV"
  int components;                  // 1 or 3
  std::span<const double> values;  // components x points, the components of one point next to each other
};
struct CellField {
  std::string name;
  int components;
  std::span<const double> values;  // components x cells
};

// One file for one moment. The volume tags of the cells are always included, as cell field "tag".
// Refuses (InputError) fields of the wrong size, other numbers of components and names used twice.
void write_vtu(const std::filesystem::path& path, const TetMesh& mesh,
               const std::vector<PointField>& point_fields, const std::vector<CellField>& cell_fields = {});

// Where the series of a wall or body stands beside a result: RESULT.h5 and LV give RESULT.LV.
std::string series_beside(const std::filesystem::path& result, const std::string& name);

class FieldSeries {
 public:
  // `path` is the folder; ".fields" is appended unless it ends so. `mesh` must outlive the series.
  // Without `resume_time_s` the series starts anew: frames of an earlier run in this folder are removed.
  // With it, frames not later than that time are kept and the next one follows them; later ones are removed.
  // Refuses (InputError) to resume a series of a mesh of other size, or one whose index cannot be read.
  FieldSeries(std::filesystem::path path, const TetMesh& mesh, std::optional<double> resume_time_s = {});

  // Of several processes one alone owns the series and writes. Times must increase (InputError otherwise).
  void write(double time_s, const std::vector<PointField>& point_fields,
             const std::vector<CellField>& cell_fields = {});

  struct Frame {
    double time_s;
    std::string file;  // name inside the folder
  };
  const std::vector<Frame>& frames() const { return frames_; }
  const std::filesystem::path& folder() const { return folder_; }
  std::filesystem::path index() const { return folder_ / "index.pvd"; }

 private:
  void write_index() const;
  void remove_unlisted_frames() const;
  std::string mesh_line() const;

  std::filesystem::path folder_;
  const TetMesh& mesh_;
  std::vector<Frame> frames_;
};

}  // namespace wiggers
