"""Parts of the coarse discrete shell: the coarse mesh, its calibrated shell, prolongation and compiled steps."""
