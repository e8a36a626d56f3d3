// The tissue's tests, on one process or under mpirun. Ranks above 0 run everything and say nothing; a failure
// on any of them fails the whole.
#define CATCH_CONFIG_RUNNER
#include <mpi.h>

#include <catch2/catch.hpp>
#include <cstdio>
#include <wiggers/tissue/parallel/algebra.hpp>

int main(int argc, char** argv) {
  const wiggers::ParallelSession parallel(&argc, &argv);
  int rank = 0;
  MPI_Comm_rank(MPI_COMM_WORLD, &rank);
  if (rank > 0 && !std::freopen("/dev/null", "w", stdout)) return 1;
  const int mine = Catch::Session().run(argc, argv);
  int worst = 0;
  MPI_Allreduce(&mine, &worst, 1, MPI_INT, MPI_MAX, MPI_COMM_WORLD);
  return worst;
}
