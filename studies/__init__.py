"""One module for each question: ``main`` measures, ``table`` writes the page, ``FIGURES`` names the pictures."""
