"""How the programs of this folder answer the command that started them.

They write no file themselves: files, lines to be shown and, if it comes to that, the one reason why there is nothing
go through a pipe to the command, which has the project's one safe writer. Each part is a line "KIND NAME LENGTH" and
its bytes; "end" says that all has been sent.
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass
class Written:
    """A file of the answer: where the command will write it, and what."""

    path: Path
    data: bytes

    def __str__(self):
        return str(self.path)


class Answer:
    def __init__(self, descriptor, folder):
        self._pipe = os.fdopen(descriptor, "wb")
        self.folder = Path(folder)

    def file(self, name, data):
        self._part("file", data, name)
        return Written(self.folder / name, data)

    def say(self, line):
        self._part("say", f"{line}\n".encode())

    def _part(self, kind, data, name="-"):
        self._pipe.write(f"{kind} {name} {len(data)}\n".encode() + data)

    def end(self):
        self._pipe.write(b"end - 0\n")
        self._pipe.close()

    def give_up(self, kind, reason):
        """`kind`: "refuse" where the input is at fault, "fail" where the machine is."""
        self._part(kind, " ".join(reason.split()).encode())
        self.end()


def answer_with(work, subject, folder, descriptor):
    """Does the work; whatever stops it is told in one line about `subject`."""
    answer = Answer(int(descriptor), folder)
    try:
        work(subject, answer)
        answer.end()
    except ImportError as error:
        answer.give_up("fail", f"{sys.executable} has no module {error.name or error}: the report needs h5py, matplotlib and "
                               "Pillow (make setup installs them; WIGGERS_PYTHON names another Python)")
    except MemoryError:
        answer.give_up("fail", f"{subject}: there is not enough memory to draw it")
    except (BrokenPipeError, KeyboardInterrupt):
        os._exit(1)
    except OSError as error:
        if error.errno:
            answer.give_up("fail", f"{error.filename or subject}: {error.strerror}")
        else:  # h5py's own, of what stands in the file
            answer.give_up("refuse", f"'{subject}' cannot be read: {error}")
    except Exception as error:  # the work trusts the file: what it trips over stands there
        what = f"there is no {error.args[0]}" if isinstance(error, KeyError) and error.args else f"{type(error).__name__}: {error}"
        answer.give_up("refuse", f"'{subject}' is damaged or of another version: {what}")
