"""Direct solvers for sparse symmetric systems: multifrontal Cholesky for large ones, profile factors for small ones."""

from modalshell.linalg.cholesky import BlockCholesky, CholeskyAnalysis, NotPositiveDefiniteError, block_graph
from modalshell.linalg.conjugate_gradients import Stop
from modalshell.linalg.profile import Profile, ProfileAnalysis, ProfileFactor

__all__ = [
    "BlockCholesky",
    "CholeskyAnalysis",
    "NotPositiveDefiniteError",
    "Profile",
    "ProfileAnalysis",
    "ProfileFactor",
    "Stop",
    "block_graph",
]
