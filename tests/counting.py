"""Work counted in lines of Python, which does not depend on the machine."""

import sys
from pathlib import Path

import modalshell

PACKAGE = str(Path(modalshell.__file__).parent)


def lines_run(call):
    """Lines of the package that a call runs: they grow with a mesh only where Python loops over it."""
    count = 0

    def line(_frame, event, _argument):
        nonlocal count
        count += event == "line"
        return line

    def enter(frame, _event, _argument):
        return line if frame.f_code.co_filename.startswith(PACKAGE) else None

    before = sys.gettrace()
    sys.settrace(enter)
    try:
        call()
    finally:
        sys.settrace(before)
    return count
