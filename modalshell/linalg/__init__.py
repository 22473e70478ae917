"""Direct solution of sparse symmetric positive definite systems: a multifrontal Cholesky factorisation of blocks."""

from modalshell.linalg.cholesky import BlockCholesky, CholeskyAnalysis, NotPositiveDefiniteError

__all__ = ["BlockCholesky", "CholeskyAnalysis", "NotPositiveDefiniteError"]
