"""Collecting the tests builds nothing: what a module made at its head would cost every run, also of other tests.

From the import of this module, which is the conftest's first, until ``allow`` no mesh, shell or basis is made, and
so no modes are solved and no model is built: who tries it cannot be collected.
"""

import functools
from collections import defaultdict

import pytest

import modalshell as ms

KINDS = (ms.TriangleMesh, ms.Shell, ms.Basis, ms.Flock)
"""Every model, simulation and picture starts with one of them."""


class BuiltInCollectionError(Exception):
    """A test module that builds where it is imported."""


def _refusing(kind):
    @functools.wraps(kind.__init__)
    def init(*_, **__):
        raise BuiltInCollectionError(
            f"a {kind.__name__} is made while tests are collected: make it in a fixture, in the test, or by name with"
            " scenes.Made"
        )

    return init


_patch = pytest.MonkeyPatch()
for _kind in KINDS:
    _patch.setattr(_kind, "__init__", _refusing(_kind))
allow = _patch.undo


def leave_to_the_long_run(items, *, partial=False):
    """Mark as slow the cases of a parametrised test that its mark ``by_default`` does not name.

    A name of no case is an error, unless single cases were asked for (``partial``).
    """
    cases = defaultdict(set)
    for item in items:
        if (mark := item.get_closest_marker("by_default")) is not None:
            cases[item.nodeid.partition("[")[0], mark.args].add(item.callspec.id)
            if item.callspec.id not in mark.args:
                item.add_marker(pytest.mark.slow)
    for (test, named), there in cases.items():
        if not partial and not set(named) <= there:
            raise pytest.UsageError(f"{test}: by_default names no case by {sorted(set(named) - there)}")


def own_first(files, workerid, workercount, **_):
    """The files in the order in which a process of pytest-xdist collects them: from another one on than the others.

    What one process has rewritten of a file for its assertions is there for those that come to it later.
    """
    first = int(workerid.removeprefix("gw")) % workercount * len(files) // workercount
    return files[first:] + files[:first]
