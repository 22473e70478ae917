"""Named errors and warnings of the package.

Every message says what was got, what was expected and how to correct it. The command line prints such an error as one
line and exits with status 2.
"""


class ModalShellError(Exception):
    """Base of every error that this package raises on purpose."""


class MeshError(ModalShellError, ValueError):
    """A triangle mesh that cannot be a shell: names the fault and the first offending indices."""


class MaterialError(ModalShellError, ValueError):
    """Material data that is not finite, out of range or of the wrong shape."""


class SupportError(ModalShellError, ValueError):
    """Supports that name no vertex, vertices out of range, or the whole shell."""


class LoadError(ModalShellError, ValueError):
    """Gravity or forces of the wrong shape or with values that are not finite."""


class OptionError(ModalShellError, ValueError):
    """An option, count, step or expression outside what is allowed."""


class SolverError(ModalShellError, RuntimeError):
    """A linear solve or an eigensolve without a usable result."""


class FileFormatError(ModalShellError, ValueError):
    """A file that cannot be read as what it claims to be."""


class SceneError(ModalShellError, ValueError):
    """A scene file with a key or value that is not allowed: names the file and the key's path."""


class WorkerError(ModalShellError, RuntimeError):
    """Worker processes of a sweep that do not start, or a cluster that does not answer."""


class ModalShellWarning(UserWarning):
    """A result that is valid but needs care."""


REPAIR = "ms.repair(vertices, faces) or, on the command line, --repair"
"""How a message names the repair of a mesh."""
SPLIT = "split=True, --split on the command line, split = true in [mesh]"
"""How a message names the splitting of edges of three or more faces."""
