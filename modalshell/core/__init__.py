"""What every folder uses: errors, checks of input, outcomes, units, limits of memory, counted cost, thread safety."""
