"""Direct solution of sparse symmetric systems: multifrontal Cholesky of large ones, profile factors of small ones."""

from modalshell.linalg.cholesky import BlockCholesky, CholeskyAnalysis, NotPositiveDefiniteError, block_graph
from modalshell.linalg.profile import ProfileAnalysis, ProfileFactor

__all__ = [
    "BlockCholesky",
    "CholeskyAnalysis",
    "NotPositiveDefiniteError",
    "ProfileAnalysis",
    "ProfileFactor",
    "block_graph",
]
