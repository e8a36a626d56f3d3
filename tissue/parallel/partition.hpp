// The mesh split over MPI ranks, and numbered nodes on it.
//
// deal.II partitions the cells (METIS), finds each rank's ghost cells and distributes the degrees of freedom;
// what the tissue computes with are the plain arrays below. A rank holds its own cells and one layer of ghost
// cells, so that it can assemble every row of its own nodes without talking to anybody.
//
// Every node also has a number that does not depend on the partition (its vertex or edge in the file's
// order): fields, checkpoints and reports use that one.
#pragma once

#include <mpi.h>

#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>
#include <wiggers/tissue/mesh/mesh.hpp>

namespace wiggers {

// Who needs which of my nodes, by rank.
struct NodeExchange {
  std::vector<int> receive_counts, receive_offsets, send_counts, send_offsets, send_nodes;
};

// Scalar Lagrange nodes of one order on all cells, or on the conductive ones.
struct NodeSpace {
  int order = 1;
  int nodes_per_cell = 4;  // 4 or 10: vertices, then edges 01 12 20 03 13 23
  int first = 0;           // global number of the first own node
  int n_own = 0;           // own nodes: local numbers 0 .. n_own - 1
  int n_local = 0;         // with ghosts
  int n_global = 0;
  std::vector<int> ghosts;      // global numbers of the local nodes n_own .. n_local - 1
  std::vector<int> file_index;  // partition-independent number of each local node, 0 .. n_global - 1
  std::vector<int> cell_nodes;  // local nodes of each local cell; -1 where the cell has none
  std::vector<int> vertex;      // file vertex of each local node, or -1 (edge nodes)
  std::vector<Point3> points;   // of each local node, m
  NodeExchange exchange;

  std::span<const int> nodes_of(int cell) const {
    return {&cell_nodes[static_cast<std::size_t>(cell) * nodes_per_cell],
            static_cast<std::size_t>(nodes_per_cell)};
  }
  bool has(int cell) const { return cell_nodes[static_cast<std::size_t>(cell) * nodes_per_cell] >= 0; }
  int global(int local) const { return local < n_own ? first + local : ghosts[local - n_own]; }
};

// A tagged boundary triangle of a local cell.
struct LocalFacet {
  int cell = 0;   // local
  int facet = 0;  // in the file's order
  int tag = 0;
  std::array<int, 3> corner{};  // which of the cell's four vertices, normal out of the tissue
};

class Partition {
 public:
  // Collective. Refuses more ranks than cells.
  Partition(std::shared_ptr<const TetMesh> mesh, MPI_Comm communicator);
  ~Partition();
  Partition(const Partition&) = delete;
  Partition& operator=(const Partition&) = delete;

  MPI_Comm communicator() const { return communicator_; }
  int rank() const { return rank_; }
  int n_ranks() const { return n_ranks_; }
  const TetMesh& mesh() const { return *mesh_; }

  // File numbers of the local cells: own ones first, then ghosts.
  const std::vector<int>& cells() const { return cells_; }
  int n_own_cells() const { return n_own_cells_; }
  // Tagged facets of the local cells.
  const std::vector<LocalFacet>& facets() const { return facets_; }

  // Collective.
  NodeSpace make_nodes(int order, bool conductive_only) const;

  // Brings the ghost values up to date: `components` numbers a node. Collective.
  void update_ghosts(const NodeSpace& space, double* values, int components) const;

  // All values in the partition-independent order, on every rank. Collective.
  std::vector<double> gather(const NodeSpace& space, const double* values, int components) const;
  // Own and ghost values out of the partition-independent order.
  static void scatter(const NodeSpace& space, std::span<const double> all, double* values, int components);
  // The values at the mesh's vertices, on every rank; `elsewhere` where the space has no node. Collective.
  std::vector<double> gather_at_vertices(const NodeSpace& space, const double* values, int components,
                                         double elsewhere) const;
  // One set of numbers a cell, in the file's order, on every rank. Collective.
  std::vector<double> gather_cells(const double* values, int components) const;

  double sum(double value) const;
  double smallest(double value) const;
  double largest(double value) const;
  bool any(bool value) const;

 private:
  struct Implementation;
  std::shared_ptr<const TetMesh> mesh_;
  MPI_Comm communicator_;
  int rank_ = 0, n_ranks_ = 1;
  std::vector<int> cells_;
  int n_own_cells_ = 0;
  std::vector<LocalFacet> facets_;
  std::unique_ptr<Implementation> implementation_;
};

}  // namespace wiggers
