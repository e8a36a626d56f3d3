#include <algorithm>
#include <wiggers/tissue/parallel/mesh_broadcast.hpp>

namespace wiggers {

namespace {

// Plain numbers in pieces that MPI's int counts can hold.
template <class Item>
void broadcast(std::vector<Item>& items, MPI_Comm communicator) {
  auto count = static_cast<long>(items.size());
  MPI_Bcast(&count, 1, MPI_LONG, 0, communicator);
  items.resize(static_cast<std::size_t>(count));
  constexpr long piece = 1L << 20;
  for (long at = 0; at < count; at += piece)
    MPI_Bcast(items.data() + at,
              static_cast<int>(std::min(piece, count - at) * static_cast<long>(sizeof(Item))), MPI_BYTE, 0,
              communicator);
}

}  // namespace

void broadcast_mesh(TetMesh& mesh, MPI_Comm communicator) {
  broadcast(mesh.points, communicator);
  broadcast(mesh.cells, communicator);
  broadcast(mesh.cell_tags, communicator);
  broadcast(mesh.facets, communicator);
  broadcast(mesh.facet_tags, communicator);
  broadcast(mesh.cell_frames, communicator);
}

}  // namespace wiggers
