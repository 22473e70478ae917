"""Collecting the tests builds nothing, or else it fails: see collecting.py, which holds for every module."""

from types import SimpleNamespace

import pytest
from collecting import KINDS, BuiltInCollectionError, leave_to_the_long_run, own_first
from scenes import Made, cantilever

import modalshell as ms


def refused(make, *arguments):
    try:
        make(*arguments)
    except BuiltInCollectionError:
        return True
    except TypeError:
        return False  # for want of arguments
    return False


MADE_AT_IMPORT = [kind.__name__ for kind in KINDS if not refused(kind)]
MADE_AT_IMPORT += [make.__name__ for make in (ms.sheet, cantilever) if not refused(make)]
MADE_AT_IMPORT += ["load_mesh"] if not refused(ms.load_mesh, "meshes/leaf.obj") else []


def test_what_is_built_at_import_is_refused():
    assert MADE_AT_IMPORT == []


def test_tests_build():
    assert not any(refused(make) for make in (*KINDS, ms.sheet, cantilever))
    assert ms.solve_modes(cantilever((4, 2)), 2).count == 2


def test_things_by_name_are_made_once_when_they_are_asked_for():
    made = []
    things = Made({"first": lambda: made.append("first") or ["a thing"], "second": lambda: made.append("second")})
    assert list(things) == ["first", "second"]
    assert len(things) == 2
    assert "second" in Made({"second": list})
    assert made == []
    assert things["first"] is things["first"]
    assert made == ["first"]
    with pytest.raises(KeyError):
        things["third"]


class _Case:
    """What ``leave_to_the_long_run`` asks of an item."""

    def __init__(self, name, *named):
        self.nodeid, self.callspec, self.marks = f"test_a.py::test_it[{name}]", SimpleNamespace(id=name), []
        self.get_closest_marker = lambda _: SimpleNamespace(args=named) if named else None
        self.add_marker = self.marks.append


def test_cases_that_are_not_named_are_slow():
    items = [_Case("one", "one"), _Case("two", "one"), _Case("three")]
    leave_to_the_long_run(items)
    assert [item.marks for item in items] == [[], [pytest.mark.slow], []]
    with pytest.raises(pytest.UsageError, match=r"test_a\.py::test_it: by_default names no case by \['four'\]"):
        leave_to_the_long_run([_Case("one", "one", "four")])
    leave_to_the_long_run([_Case("one", "one", "four")], partial=True)


def test_processes_begin_with_other_files_and_collect_all():
    files = [f"test_{number}.py" for number in range(7)]
    orders = [own_first(files, f"gw{number}", 3) for number in range(3)]
    assert [order[0] for order in orders] == ["test_0.py", "test_2.py", "test_4.py"]
    assert all(sorted(order) == files for order in orders)
    assert own_first(files, "gw3", 3) == files  # a process in place of one that crashed
