"""Commands on results."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import modalshell as ms
from modalshell.commands.terminal import progress, say
from modalshell.export import check_formats, compress, save_modal_body, save_modes_gltf
from modalshell.export.near_origin import centred
from modalshell.export.usd import save_usd
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.page import Page, clip_page

_SUFFIXES = {"usd": ".usdc", "gltf": ".glb", "pc2": ".pc2", "mdd": ".mdd", "clip": ".clip", "page": ".html"}
_SUFFIXES |= {"vtkhdf": ".vtkhdf", "pvd": ".pvd", "csv": ".csv", "body": ".npz"}
_SHOWN = (".html", ".htm", ".png", ".mp4", ".md", ".csv", ".json")


def export(
    result: Annotated[Path, Parameter(help="Trajectory (.npz), clip (.clip), basis (.npz), or the folder of a run.")],
    *,
    to: Annotated[
        Literal["usd", "gltf", "pc2", "mdd", "clip", "page", "vtkhdf", "pvd", "csv", "body"],
        Parameter(help="Format to write; 'body' is a basis as arrays for other engines, with a JSON file."),
    ],
    out: Annotated[Path | None, Parameter(help="File to write; if omitted, in the folder of RESULT.")] = None,
    up: Annotated[Literal["y", "z"], Parameter(help="Axis that points up in a USD file.")] = "z",
) -> None:
    """Convert a saved motion or basis to a format of other programs.

    Example: modalshell export results/leaf.npz --to usd
    """
    if up != "z" and to != "usd":
        raise ms.OptionError(f"--up goes with --to usd; {to} files have their own axis")
    result = result_of(result)
    target = out or (result.with_name(f"{result.stem}_body.npz") if to == "body" else result.with_suffix(_SUFFIXES[to]))
    checked_target("--out", target, (_SUFFIXES[to],), result)
    rest = target.with_name(f"{target.stem}_rest.obj")
    if to in ("pc2", "mdd"):
        refuse_foreign(rest)
    if to == "body":
        refuse_foreign(target.with_suffix(".json"), *([target] if out is None else []))
        say(*save_modal_body(ms.Basis.load(result), target), sep="\n")
        return
    check_formats([target.suffix[1:]])
    try:
        run = ms.load_clip(result) if result.suffix == ".clip" else ms.load_trajectory(result, verify=True)
    except ms.FileFormatError:
        if (basis := _saved_basis(result)) is None:
            raise
        if to == "page":
            say(basis.page(title=result.stem).save(target))
        elif to == "gltf":
            say(save_modes_gltf(basis, target))
        else:
            raise ms.OptionError(f"{result} is a basis, which is written as gltf or page (got {to})") from None
        return
    if to == "page":
        say(_played(run, result.stem).save(target))
        return
    with progress(f"{result.stem} frames") as on_frame:
        if up == "y":
            say(save_usd(run, target, on_frame, up))
        else:
            say(ms.save_trajectory(run, target, on_frame=on_frame))
    if target.suffix in (".pc2", ".mdd"):
        ms.save_mesh(ms.TriangleMesh(run.rest_positions, run.faces), rest)
        say(rest)
    if to == "csv":
        triangles = target.with_name(f"{target.stem}_triangles.csv")
        say(triangles if run.fields else "no table of the triangles: the run keeps no fields ('fields' in [output])")


def _played(run: ms.Trajectory, title: str) -> Page:
    """A page that plays a motion."""
    motion = compress(centred(run)[0])
    shapes = motion.displacements()
    # What touched the shell is known to the scene alone, and would be missed.
    notes = ["Colliders are not shown: runs do not store them. modalshell page SCENE shows them."]
    return clip_page(
        motion.times, motion.rest_positions, motion.faces, shapes, motion.amplitudes, title=title, units=motion.units,
        notes=notes if run.contact_forces.size else [],
    )  # fmt: skip


def open_result(
    result: Annotated[
        Path,
        Parameter(help="Trajectory or basis (.npz), clip, page, picture, film, report, table, or the folder of a run."),
    ],
) -> None:
    """Show whatever a result is in the web browser; motions and bases as a page in a temporary folder.

    Example: modalshell open results/leaf.npz
    """
    shown = result_of(result)
    if not shown.is_file():
        raise ms.OptionError(f"{shown} is no file: name a result, as 'results/leaf.npz', or the folder of a run")
    if shown.suffix in (".npz", ".clip"):
        page = Path(tempfile.mkdtemp(prefix="modalshell_")) / f"{shown.stem}.html"  # kept for the browser
        basis = _saved_basis(shown) if shown.suffix == ".npz" else None
        if basis is not None:
            shown = basis.page(title=shown.stem).save(page)
        else:
            run = ms.load_clip(shown) if shown.suffix == ".clip" else ms.load_trajectory(shown, verify=True)
            shown = _played(run, shown.stem).save(page)
    elif shown.suffix not in _SHOWN:
        raise ms.OptionError(
            f"{shown} is no result that a browser shows (got {shown.suffix or 'no suffix'}): name one of .npz, .clip, "
            f"{', '.join(_SHOWN)}; a scene is shown by 'modalshell view' or 'modalshell page'"
        )
    say(shown)
    if not webbrowser.open(shown.resolve().as_uri()):
        say("no browser was found: open the file in one yourself")


def result_of(path: Path) -> Path:
    """The saved motion in the folder of a run, or ``path`` itself if it is no folder."""
    if not path.is_dir():
        return path
    saved = sorted(path.glob("*.npz"))
    if len(saved) != 1:
        names = ", ".join(file.name for file in saved[:5]) or "none"
        raise ms.OptionError(f"{path} must hold one .npz file (got {names}): name the file instead")
    return saved[0]


def _saved_basis(path: Path) -> ms.Basis | None:
    """The basis of a file; None if it holds none."""
    try:
        return ms.Basis.load(path)
    except ms.FileFormatError:
        return None
