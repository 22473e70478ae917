"""Figures: ``draw(results, folder)`` of each module reads the results of a study and simulates nothing."""
