"""What this machine does against plain NumPy and SciPy; ``modalshell bench`` runs them."""
