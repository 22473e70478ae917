"""Free memory and disk space, and refusal of work that needs more, before it starts."""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from pathlib import Path

from modalshell.core.errors import OptionError

_UNKNOWN = 2**40
"""Assumed free memory if the system does not report it."""
_LITTLE = 1e6
"""Bytes that no process lacks: a short motion of a small shell takes less time than reading what is free."""
_CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def available_memory() -> int:
    """Bytes this process may still allocate: limited by the machine, its container, and its own limit."""
    free = [_UNKNOWN]
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        free += [1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    except (OSError, ValueError, IndexError):
        if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            free.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for limit, usage in _CGROUPS:
        try:
            used = int(Path(usage).read_text(encoding="ascii")) - _cached(Path(usage).with_name("memory.stat"))
            free.append(int(Path(limit).read_text(encoding="ascii")) - used)
        except (OSError, ValueError):  # "max": no limit
            continue
    try:
        import resource

        limit_of_process = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit_of_process != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            free.append(limit_of_process - pages * resource.getpagesize())
    except (ImportError, OSError, ValueError, IndexError):
        pass
    return max(min(free), 0)


def _cached(counts: Path) -> int:
    """Bytes of files that a container keeps in memory and counts as used, though they give way to whatever needs it."""
    with suppress(OSError, ValueError):
        pairs = (line.split() for line in counts.read_text(encoding="ascii").splitlines())
        return sum(int(size) for name, size in pairs if name in ("active_file", "inactive_file"))
    return 0


def gigabytes(size: float) -> str:
    """A number of bytes as text."""
    return f"{size / 1e9:.3g} GB" if size >= 1e8 else f"{size / 1e6:.3g} MB"


def demand_memory(what: str, size: float, remedy: str) -> None:
    """OptionError if ``what`` needs more bytes than are free; ``remedy`` says what would need less."""
    if size <= _LITTLE:
        return
    free = available_memory()
    if size > free:
        raise OptionError(f"{what} needs about {gigabytes(size)} of memory (got {gigabytes(free)} free): {remedy}")


def demand_disk(what: str, size: float, folder: Path, remedy: str) -> None:
    """OptionError if ``what`` takes ``size`` bytes and the disk of ``folder`` has fewer free."""
    free = shutil.disk_usage(folder).free
    if size > free:
        raise OptionError(
            f"{what} takes about {gigabytes(size)} on the disk of {folder} (got {gigabytes(free)} free): {remedy}"
        )
