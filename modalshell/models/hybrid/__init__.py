"""Parts of the hybrid: assumed membrane stresses, their steps, and its training."""
