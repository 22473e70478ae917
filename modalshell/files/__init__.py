"""Files: regular files read, atomic writes, locks, provenance, and stored results of studies."""
