"""Benchmark of factors by other packages: each that is installed solves the same systems."""

from studies.benchmarks.peers import PACKAGES, peers


def test_every_package_that_is_here_solves_the_systems_of_both_energies() -> None:
    rows = peers((6,), repeats=1)
    assert {row["energy"] for row in rows} == {"hinges", "split folds"}
    names = [row["package"] for row in rows if row["energy"] == "hinges"]
    assert names[0] == "modalshell"
    assert set(names) <= set(PACKAGES)
    assert all(row["residual"] < 1e-11 for row in rows)
    assert all(row["factor [ms]"] >= 0.0 for row in rows)
