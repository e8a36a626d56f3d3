#include <deal.II/base/mpi.h>
#include <deal.II/distributed/fully_distributed_tria.h>
#include <deal.II/dofs/dof_handler.h>
#include <deal.II/dofs/dof_tools.h>
#include <deal.II/fe/fe_nothing.h>
#include <deal.II/fe/fe_simplex_p.h>
#include <deal.II/grid/grid_tools.h>
#include <deal.II/grid/tria_description.h>
#include <deal.II/hp/fe_collection.h>
#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <unordered_map>
#include <wiggers/core/errors.hpp>
#include <wiggers/tissue/mesh/reference_cell.hpp>
#include <wiggers/tissue/parallel/partition.hpp>

namespace wiggers {

namespace {

namespace dl = dealii;

std::uint64_t edge_key(int a, int b) {
  if (a > b) std::swap(a, b);
  return static_cast<std::uint64_t>(a) << 32 | static_cast<std::uint32_t>(b);
}

std::array<int, 3> sorted(std::array<int, 3> a) {
  std::sort(a.begin(), a.end());
  return a;
}

}  // namespace

struct Partition::Implementation {
  explicit Implementation(MPI_Comm communicator) : triangulation(communicator) {}
  dl::parallel::fullydistributed::Triangulation<3> triangulation;
  // File numbers of edges: sorted vertex pairs in ascending order, so that they follow from the mesh alone.
  std::vector<std::uint64_t> edges;
};

Partition::~Partition() = default;

Partition::Partition(std::shared_ptr<const TetMesh> mesh, MPI_Comm communicator)
    : mesh_(std::move(mesh)),
      communicator_(communicator),
      implementation_(std::make_unique<Implementation>(communicator)) {
  MPI_Comm_rank(communicator, &rank_);
  MPI_Comm_size(communicator, &n_ranks_);
  if (mesh_->cells.empty()) throw InputError("the mesh has no tetrahedra");
  if (static_cast<std::size_t>(n_ranks_) > mesh_->cells.size())
    throw InputError(fmt::format("{} MPI ranks for a mesh of {} tetrahedra: use at most {}", n_ranks_,
                                 mesh_->cells.size(), mesh_->cells.size()));

  const auto create = [&](dl::Triangulation<3>& serial) {
    std::vector<dl::Point<3>> points;
    points.reserve(mesh_->points.size());
    for (const Point3& p : mesh_->points) points.emplace_back(p[0], p[1], p[2]);
    std::vector<dl::CellData<3>> cells;
    cells.reserve(mesh_->cells.size());
    for (std::size_t c = 0; c < mesh_->cells.size(); ++c) {
      dl::CellData<3> cell(4);
      for (int v = 0; v < 4; ++v) cell.vertices[v] = static_cast<unsigned>(mesh_->cells[c][v]);
      cell.material_id = static_cast<dl::types::material_id>(mesh_->cell_tags[c]);
      cells.push_back(cell);
    }
    serial.create_triangulation(points, cells, dl::SubCellData());
  };
  const auto partition = [&](dl::Triangulation<3>& serial, MPI_Comm, unsigned) {
    // Electrophysiology and activation live on conductive cells only.
    std::vector<unsigned> weights;
    for (int tag : mesh_->cell_tags) weights.push_back(mesh_tags::conductive(tag) ? 3 : 1);
    dl::GridTools::partition_triangulation(n_ranks_, weights, serial);
  };
  const auto description =
      dl::TriangulationDescription::Utilities::create_description_from_triangulation_in_groups<3, 3>(
          create, partition, communicator, n_ranks_);
  implementation_->triangulation.create_triangulation(description);

  std::vector<int> ghosts;
  for (const auto& cell : implementation_->triangulation.active_cell_iterators()) {
    const int file = static_cast<int>(cell->id().get_coarse_cell_id());
    if (cell->is_locally_owned())
      cells_.push_back(file);
    else if (cell->is_ghost())
      ghosts.push_back(file);
    else
      continue;
    for (int v = 0; v < 4; ++v) {
      const Point3& expected = mesh_->points[mesh_->cells[file][v]];
      for (int k = 0; k < 3; ++k)
        if (cell->vertex(v)[k] != expected[k])
          throw std::logic_error("deal.II has renumbered the vertices of a cell");
    }
  }
  std::sort(cells_.begin(), cells_.end());
  std::sort(ghosts.begin(), ghosts.end());
  n_own_cells_ = static_cast<int>(cells_.size());
  cells_.insert(cells_.end(), ghosts.begin(), ghosts.end());
  if (any(n_own_cells_ == 0))
    throw InputError(fmt::format("{} MPI ranks are too many for this mesh of {} tetrahedra: a rank got none",
                                 n_ranks_, mesh_->cells.size()));

  // Facets of the local cells.
  std::map<std::array<int, 3>, int> tagged;
  for (std::size_t f = 0; f < mesh_->facets.size(); ++f)
    tagged.emplace(sorted(mesh_->facets[f]), static_cast<int>(f));
  for (std::size_t c = 0; c < cells_.size(); ++c) {
    const auto& vertices = mesh_->cells[cells_[c]];
    for (int opposite = 0; opposite < 4; ++opposite) {
      std::array<int, 3> corner{};
      for (int v = 0, k = 0; v < 4; ++v)
        if (v != opposite) corner[k++] = v;
      // Positive cells: seen from the opposite vertex the order (1,2,3), (0,3,2), (0,1,3), (0,2,1) turns so
      // that the normal points out.
      if (opposite % 2 == 1) std::swap(corner[1], corner[2]);
      const auto found = tagged.find(sorted({vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]}));
      if (found == tagged.end()) continue;
      facets_.push_back({static_cast<int>(c), found->second, mesh_->facet_tags[found->second], corner});
    }
  }

  auto& edges = implementation_->edges;
  for (const auto& cell : mesh_->cells)
    for (const auto& ends : tetrahedron_edges) edges.push_back(edge_key(cell[ends[0]], cell[ends[1]]));
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
}

namespace {

// Ghosts of one owner stand together, in ascending order, as the owner sends them.
NodeExchange make_exchange(const NodeSpace& space, MPI_Comm communicator, int n_ranks) {
  NodeExchange x;
  std::vector<int> firsts(n_ranks);
  MPI_Allgather(&space.first, 1, MPI_INT, firsts.data(), 1, MPI_INT, communicator);
  x.receive_counts.assign(n_ranks, 0);
  for (int global : space.ghosts) {
    const auto owner = std::upper_bound(firsts.begin(), firsts.end(), global) - firsts.begin() - 1;
    ++x.receive_counts[owner];
  }
  const auto offsets = [](const std::vector<int>& counts) {
    std::vector<int> from(counts.size() + 1, 0);
    for (std::size_t k = 0; k < counts.size(); ++k) from[k + 1] = from[k] + counts[k];
    return from;
  };
  x.receive_offsets = offsets(x.receive_counts);
  x.send_counts.resize(n_ranks);
  MPI_Alltoall(x.receive_counts.data(), 1, MPI_INT, x.send_counts.data(), 1, MPI_INT, communicator);
  x.send_offsets = offsets(x.send_counts);
  x.send_nodes.resize(x.send_offsets.back());
  MPI_Alltoallv(space.ghosts.data(), x.receive_counts.data(), x.receive_offsets.data(), MPI_INT,
                x.send_nodes.data(), x.send_counts.data(), x.send_offsets.data(), MPI_INT, communicator);
  for (int& node : x.send_nodes) node -= space.first;
  return x;
}

}  // namespace

NodeSpace Partition::make_nodes(int order, bool conductive_only) const {
  NodeSpace space;
  space.order = order;
  space.nodes_per_cell = order == 1 ? 4 : 10;
  const auto& triangulation = implementation_->triangulation;
  dl::DoFHandler<3> dofs(triangulation);
  const dl::FE_SimplexP<3> shapes(order);
  const dl::hp::FECollection<3> elements(shapes, dl::FE_Nothing<3>(dl::ReferenceCells::Tetrahedron));
  const auto is_in = [&](int file_cell) {
    return !conductive_only || mesh_tags::conductive(mesh_->cell_tags[file_cell]);
  };
  if (conductive_only) {
    for (const auto& cell : dofs.active_cell_iterators())
      if (cell->is_locally_owned())
        cell->set_active_fe_index(is_in(static_cast<int>(cell->id().get_coarse_cell_id())) ? 0 : 1);
    dofs.distribute_dofs(elements);
  } else {
    dofs.distribute_dofs(elements[0]);
  }
  const dl::IndexSet& own = dofs.locally_owned_dofs();
  dl::IndexSet relevant;
  dl::DoFTools::extract_locally_relevant_dofs(dofs, relevant);
  space.n_global = static_cast<int>(dofs.n_dofs());
  space.n_own = static_cast<int>(own.n_elements());
  // Prefix sum instead of the set's first index: a rank may own no node.
  MPI_Exscan(&space.n_own, &space.first, 1, MPI_INT, MPI_SUM, communicator_);
  if (rank_ == 0) space.first = 0;
  dl::IndexSet foreign(relevant);
  foreign.subtract_set(own);
  for (const auto index : foreign) space.ghosts.push_back(static_cast<int>(index));
  space.n_local = space.n_own + static_cast<int>(space.ghosts.size());

  // The partition-independent numbers: vertices, then edges, of the cells concerned, without gaps.
  const auto& edges = implementation_->edges;
  const auto edge_number = [&](int a, int b) {
    return static_cast<int>(std::lower_bound(edges.begin(), edges.end(), edge_key(a, b)) - edges.begin());
  };
  std::vector<int> compressed(mesh_->points.size() + (order == 2 ? edges.size() : 0), 0);
  const auto for_each_entity = [&](int file_cell, auto&& visit) {
    const auto& v = mesh_->cells[file_cell];
    for (int k = 0; k < 4; ++k) visit(k, v[k]);
    if (order == 2)
      for (int e = 0; e < 6; ++e)
        visit(4 + e, static_cast<int>(mesh_->points.size()) +
                         edge_number(v[tetrahedron_edges[e][0]], v[tetrahedron_edges[e][1]]));
  };
  for (std::size_t c = 0; c < mesh_->cells.size(); ++c)
    if (is_in(static_cast<int>(c)))
      for_each_entity(static_cast<int>(c), [&](int, int entity) { compressed[entity] = 1; });
  int count = 0;
  for (int& number : compressed) number = number ? count++ : -1;

  space.file_index.assign(space.n_local, -1);
  space.vertex.assign(space.n_local, -1);
  space.points.resize(space.n_local);
  space.cell_nodes.assign(cells_.size() * space.nodes_per_cell, -1);
  std::unordered_map<int, int> local_cell;
  for (std::size_t c = 0; c < cells_.size(); ++c) local_cell.emplace(cells_[c], static_cast<int>(c));
  std::unordered_map<int, int> ghost_number;
  for (std::size_t g = 0; g < space.ghosts.size(); ++g)
    ghost_number.emplace(space.ghosts[g], space.n_own + static_cast<int>(g));
  std::vector<dl::types::global_dof_index> indices(space.nodes_per_cell);
  for (const auto& cell : dofs.active_cell_iterators()) {
    if (cell->is_artificial()) continue;
    const int file = static_cast<int>(cell->id().get_coarse_cell_id());
    if (!is_in(file)) continue;
    const int c = local_cell.at(file);
    cell->get_dof_indices(indices);
    int* nodes = &space.cell_nodes[static_cast<std::size_t>(c) * space.nodes_per_cell];
    const auto local = [&](dl::types::global_dof_index index) {
      const int global = static_cast<int>(index);
      return global >= space.first && global < space.first + space.n_own ? global - space.first
                                                                         : ghost_number.at(global);
    };
    for (int v = 0; v < 4; ++v) nodes[v] = local(indices[v]);
    if (order == 2)
      for (int line = 0; line < 6; ++line) {
        // By the ends, whatever deal.II's order of lines.
        int end[2];
        for (int k = 0; k < 2; ++k)
          for (int v = 0; v < 4; ++v)
            if (cell->line(line)->vertex_index(k) == cell->vertex_index(v)) end[k] = v;
        for (int e = 0; e < 6; ++e)
          if ((tetrahedron_edges[e][0] == end[0] && tetrahedron_edges[e][1] == end[1]) ||
              (tetrahedron_edges[e][0] == end[1] && tetrahedron_edges[e][1] == end[0]))
            nodes[4 + e] = local(indices[4 + line]);
      }
    for_each_entity(file, [&](int k, int entity) { space.file_index[nodes[k]] = compressed[entity]; });
    const auto& v = mesh_->cells[file];
    for (int k = 0; k < 4; ++k) {
      space.vertex[nodes[k]] = v[k];
      space.points[nodes[k]] = mesh_->points[v[k]];
    }
    if (order == 2)
      for (int e = 0; e < 6; ++e) {
        const Point3 &a = mesh_->points[v[tetrahedron_edges[e][0]]],
                     &b = mesh_->points[v[tetrahedron_edges[e][1]]];
        for (int k = 0; k < 3; ++k) space.points[nodes[4 + e]][k] = 0.5 * (a[k] + b[k]);
      }
  }
  if (count != space.n_global) throw std::logic_error("nodes and mesh entities differ in number");
  space.exchange = make_exchange(space, communicator_, n_ranks_);
  return space;
}

void Partition::update_ghosts(const NodeSpace& space, double* values, int components) const {
  if (n_ranks_ == 1) return;
  const NodeExchange& x = space.exchange;
  std::vector<double> out(x.send_nodes.size() * components);
  for (std::size_t k = 0; k < x.send_nodes.size(); ++k)
    for (int c = 0; c < components; ++c) out[k * components + c] = values[x.send_nodes[k] * components + c];
  std::vector<MPI_Request> requests;
  for (int r = 0; r < n_ranks_; ++r) {
    if (x.receive_counts[r] > 0) {
      requests.emplace_back();
      MPI_Irecv(values + (space.n_own + x.receive_offsets[r]) * components, x.receive_counts[r] * components,
                MPI_DOUBLE, r, 71, communicator_, &requests.back());
    }
    if (x.send_counts[r] > 0) {
      requests.emplace_back();
      MPI_Isend(out.data() + x.send_offsets[r] * components, x.send_counts[r] * components, MPI_DOUBLE, r, 71,
                communicator_, &requests.back());
    }
  }
  MPI_Waitall(static_cast<int>(requests.size()), requests.data(), MPI_STATUSES_IGNORE);
}

namespace {

std::vector<double> gather_by_index(MPI_Comm communicator, int n_ranks, const int* index, int n_own,
                                    const double* values, int components, int n_global) {
  std::vector<double> all(static_cast<std::size_t>(n_global) * components);
  if (n_ranks == 1) {
    for (int k = 0; k < n_own; ++k)
      std::copy_n(values + static_cast<std::size_t>(k) * components, components,
                  &all[static_cast<std::size_t>(index[k]) * components]);
    return all;
  }
  std::vector<int> counts(n_ranks), offsets(n_ranks, 0);
  MPI_Allgather(&n_own, 1, MPI_INT, counts.data(), 1, MPI_INT, communicator);
  for (int r = 1; r < n_ranks; ++r) offsets[r] = offsets[r - 1] + counts[r - 1];
  const int total = offsets.back() + counts.back();
  std::vector<int> indices(total);
  MPI_Allgatherv(index, n_own, MPI_INT, indices.data(), counts.data(), offsets.data(), MPI_INT, communicator);
  // One component at a time, so that counts stay within int for any mesh that fits.
  std::vector<double> mine(n_own), theirs(total);
  for (int c = 0; c < components; ++c) {
    for (int k = 0; k < n_own; ++k) mine[k] = values[static_cast<std::size_t>(k) * components + c];
    MPI_Allgatherv(mine.data(), n_own, MPI_DOUBLE, theirs.data(), counts.data(), offsets.data(), MPI_DOUBLE,
                   communicator);
    for (int k = 0; k < total; ++k) all[static_cast<std::size_t>(indices[k]) * components + c] = theirs[k];
  }
  return all;
}

}  // namespace

std::vector<double> Partition::gather(const NodeSpace& space, const double* values, int components) const {
  return gather_by_index(communicator_, n_ranks_, space.file_index.data(), space.n_own, values, components,
                         space.n_global);
}

std::vector<double> Partition::gather_at_vertices(const NodeSpace& space, const double* values,
                                                  int components, double elsewhere) const {
  // Each node takes the number of its vertex along.
  const int width = components + 1;
  std::vector<double> own(static_cast<std::size_t>(space.n_own) * width);
  for (int k = 0; k < space.n_own; ++k) {
    own[k * width] = space.vertex[k];
    for (int c = 0; c < components; ++c) own[k * width + 1 + c] = values[k * components + c];
  }
  const std::vector<double> all = gather(space, own.data(), width);
  std::vector<double> field(mesh_->points.size() * components, elsewhere);
  for (std::size_t k = 0; k < all.size(); k += width)
    if (all[k] >= 0)
      for (int c = 0; c < components; ++c)
        field[static_cast<std::size_t>(all[k]) * components + c] = all[k + 1 + c];
  return field;
}

std::vector<double> Partition::gather_cells(const double* values, int components) const {
  return gather_by_index(communicator_, n_ranks_, cells_.data(), n_own_cells_, values, components,
                         static_cast<int>(mesh_->cells.size()));
}

void Partition::scatter(const NodeSpace& space, std::span<const double> all, double* values, int components) {
  for (int k = 0; k < space.n_local; ++k)
    std::copy_n(&all[static_cast<std::size_t>(space.file_index[k]) * components], components,
                values + static_cast<std::size_t>(k) * components);
}

namespace {
double reduce(double value, MPI_Op operation, MPI_Comm communicator) {
  double result = 0;
  MPI_Allreduce(&value, &result, 1, MPI_DOUBLE, operation, communicator);
  return result;
}
}  // namespace

double Partition::sum(double value) const { return reduce(value, MPI_SUM, communicator_); }
double Partition::smallest(double value) const { return reduce(value, MPI_MIN, communicator_); }
double Partition::largest(double value) const { return reduce(value, MPI_MAX, communicator_); }
bool Partition::any(bool value) const { return reduce(value ? 1 : 0, MPI_MAX, communicator_) > 0; }

}  // namespace wiggers
