// Work that may fail on one rank alone. All ranks then fail, with the message of the first: nobody is left
// waiting in the next exchange.
#pragma once

#include <mpi.h>

#include <exception>
#include <string>
#include <wiggers/core/errors.hpp>
#include <wiggers/core/progress.hpp>

namespace wiggers {

template <class Work>
void collectively(MPI_Comm communicator, Work&& work) {
  // 0: fine; 1: numerical failure; 2: bad input; 3: stopped on request; 4: anything else.
  int kind = 0;
  std::string message;
  try {
    work();
  } catch (const NumericalFailure& error) {
    kind = 1;
    message = error.what();
  } catch (const InputError& error) {
    kind = 2;
    message = error.what();
  } catch (const Interrupted& error) {
    kind = 3;
    message = error.what();
  } catch (const std::exception& error) {
    kind = 4;
    message = error.what();
  }
  int rank = 0, n_ranks = 1;
  MPI_Comm_rank(communicator, &rank);
  MPI_Comm_size(communicator, &n_ranks);
  const int mine = kind == 0 ? n_ranks : rank;
  int first = 0;
  MPI_Allreduce(&mine, &first, 1, MPI_INT, MPI_MIN, communicator);
  if (first == n_ranks) return;
  auto length = static_cast<int>(message.size());
  MPI_Bcast(&kind, 1, MPI_INT, first, communicator);
  MPI_Bcast(&length, 1, MPI_INT, first, communicator);
  message.resize(length);
  MPI_Bcast(message.data(), length, MPI_CHAR, first, communicator);
  if (kind == 1) throw NumericalFailure(message);
  if (kind == 2) throw InputError(message);
  if (kind == 3) throw Interrupted(message);
  throw ResourceError(message);
}

// Between parts of long work: all ranks stop if any was asked to.
inline void check_interrupt_of_all(MPI_Comm communicator) { collectively(communicator, check_interrupt); }

// Shows progress and says, on all ranks alike, whether any of them was asked to stop.
inline bool stop_asked(MPI_Comm communicator, Progress& progress, double fraction, const std::string& note) {
  int stop = interrupt_requested() ? 1 : 0;
  try {
    progress.update(fraction, note);
  } catch (const Interrupted&) {
    stop = 1;
  }
  MPI_Allreduce(MPI_IN_PLACE, &stop, 1, MPI_INT, MPI_MAX, communicator);
  return stop != 0;
}

}  // namespace wiggers
