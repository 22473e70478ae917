"""All benchmarks: tables in Markdown, rows in JSON, and a log-log picture of a frame's cost (``modalshell bench``)."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import llvmlite.binding
import numba

from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import make_folder, write_text
from modalshell.files.provenance import run_record
from modalshell.kernels import packed
from modalshell.render.curves import Curve, Panel, draw_curves
from studies.benchmarks import (
    contact,
    crowd,
    discrete_shell,
    factorisation,
    frame,
    hybrid,
    modes,
    motion,
    peers,
    self_contact,
)

COLORS = {4: "#2b5fc8", 8: "#2f9e44", 32: "#c8802b", 128: "#c8322b"}


def main(
    out: Path, quick: bool = False, only: str | None = None, on_step: Callable[[int, int], None] | None = None
) -> list[Path]:
    """Run the benchmarks into ``out``; ``quick`` leaves out the largest sizes, ``only`` names one of them."""
    sizes = (1000, 13117) if quick else (1000, 13117, 100000)
    jobs: dict[str, Callable[[], Any]] = {
        "frame": lambda: frame.benchmark(sizes, (4, 32) if quick else (4, 8, 32, 128)),
        "frame_scaling": lambda: frame.scaling(),
        "motion": lambda: motion.frames((80, 16) if quick else (250, 52)),
        "motion_rules": lambda: motion.rules((315,) if quick else tuple(motion.STRIPS)),
        "hybrid": lambda: hybrid.frames((44,), 24, 4, 3) if quick else hybrid.frames(),
        "hinge_kernel": lambda: [frame.hinge_kernel()],
        "modes": lambda: modes.benchmark((13000,) if quick else (13000, 100000)),
        "refactorisation": lambda: factorisation.refactorisation((50,) if quick else (50, 100, 115)),
        "peers": lambda: peers.peers((50,) if quick else (50, 100, 200)),
        "statics": lambda: factorisation.statics((60, 10) if quick else (245, 40)),
        "building": lambda: factorisation.building(99 if quick else 999),
        "assembly": lambda: [discrete_shell.assembly(energy) for energy in discrete_shell.ENERGIES],
        "implicit_steps": lambda: discrete_shell.implicit_steps((50,) if quick else (50, 100, 150)),
        "self_contact": lambda: self_contact.folded_strip((48, 8) if quick else (154, 12)),
        "contact": lambda: contact.frames(((20, 4),) if quick else ((20, 4), (250, 52))),
        "crowd": lambda: crowd.reconstruction(512 if quick else 4096),
        "flock": lambda: crowd.flock((1000, 10000) if quick else (1000, 10000, 100000)),
        "devices": lambda: [
            row for sizes in (crowd.DEVICES[:1] if quick else crowd.DEVICES) for row in crowd.on_devices(*sizes)
        ],
    }
    if only is not None:
        if only not in jobs:
            raise OptionError(f"there is no benchmark {only!r}; choose from {', '.join(jobs)}")
        jobs = {only: jobs[only]}
    make_folder(out)
    record = run_record({"quick": quick, "only": only})
    stem = "benchmarks" if only is None else f"benchmarks_{only}"
    rows: dict[str, list[dict[str, Any]]] = {}
    written: list[Path] = []
    for done, (name, job) in enumerate(jobs.items(), start=1):
        rows[name] = job()
        written = written_to(out, stem, rows, record)  # each time, as a run that is stopped keeps what it has
        if on_step is not None:
            on_step(done, len(jobs))
    if "frame" in rows and "frame_scaling" in rows:
        written.append(draw(rows["frame"], rows["frame_scaling"], out / "benchmarks.png"))
    return written


def written_to(out: Path, stem: str, rows: dict[str, list[dict[str, Any]]], record: Mapping[str, Any]) -> list[Path]:
    """The files of the tables so far: their rows with the record of the run, and a page."""
    written = [write_text(out / f"{stem}.json", json.dumps({"record": record, "rows": rows}, indent=1) + "\n")]
    pages = "\n\n".join(f"## {name}\n\n{table(found)}" for name, found in rows.items())
    written.append(
        write_text(out / f"{stem}.md", f"# Benchmarks\n\nMade by `modalshell bench` on {processor()}.\n\n{pages}\n")
    )
    return written


def processor() -> str:
    """The processor as LLVM names it, or the target that numba is set to, and the width of its registers."""
    name = numba.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()  # type: ignore[attr-defined]
    return f"a {platform.machine()} processor ({name}), kernels for registers of {8 * packed.BYTES} bits"


def table(rows: list[dict[str, Any]]) -> str:
    """Rows as a Markdown table."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    lines += ["| " + " | ".join(_text(row[name]) for name in names) + " |" for row in rows]
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {100 * share:.0f} %" for name, share in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def draw(frames: list[dict[str, Any]], scaling: list[dict[str, Any]], path: Path) -> Path:
    """Cost of a frame against n for each m, and its distance from a straight line."""
    plain = [row for row in frames if row["dtype"] == "float64" and row["threads"] == 1]
    curves = []
    for m in sorted({row["m"] for row in plain}):
        chosen = [row for row in plain if row["m"] == m]
        n = [row["n"] for row in chosen]
        curves.append(Curve(n, [row["seconds_frame"] for row in chosen], f"m = {m}", COLORS[m]))
        curves.append(Curve(n, [row["seconds_numpy"] for row in chosen], f"m = {m}, NumPy", COLORS[m], dashed=True))
    n = [row["n"] for row in scaling]
    fit = [row["seconds_call"] + row["seconds_vertex"] * row["n"] for row in scaling]
    lines = [
        Curve(n, [row["seconds_frame"] for row in scaling], "m = 4, data from memory", "#2b5fc8"),
        Curve(n, fit, "line through all sizes", "#555555", dashed=True),
    ]
    labels = ("vertices n", "seconds a frame (float64, one thread)")
    return draw_curves(
        [
            Panel(curves, "a frame, back to back", *labels, log=True, log_x=True),
            Panel(lines, "linear in n", *labels, log=True, log_x=True),
        ],
        path,
    )
