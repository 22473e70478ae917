"""Write ``studies/README.md``: a picture and the finding of each study, from its module and its committed page.

Run ``python -m studies.readme`` in a checkout, after a study's page or picture has changed; with a folder of results
and names of studies, ``python -m studies.readme results snap``, it takes over their pages and findings first.
"""

from __future__ import annotations

import ast
import html
import json
import re
import sys
from pathlib import Path

from modalshell.files.atomic_io import write_text
from studies.pages import FOLDER, committed
from studies.reproduce import studies

HEAD = """# Studies

Each study answers one question. Its module explains how, its page has every number, and its figure module draws the
result.

```sh
modalshell reproduce --only flat_vs_v_beam
```

writes `results/flat_vs_v_beam.json`, `.npz` and `.md`, and the picture into `results/figures`; `--quick` takes coarser
meshes, `--all` runs every study. The page and the findings that are committed here as `studies/NAME.md` and
`studies/NAME.json` are of a full run; its times hold for the machine that ran it. Findings whose record names a page
were read from that page, to its precision. [.github/CONTRIBUTING.md](../.github/CONTRIBUTING.md) explains how to add a
study. `python -m studies.readme` writes this page.

[theory/README.md](theory/README.md) derives what modalshell computes.

## The paper's figures

`modalshell reproduce` draws these, from studies in the table below.

| figure | what it shows |
|---|---|
"""
BENCHMARKS = """
## Benchmarks

```sh
modalshell bench
python -m studies.benchmarks.ranks --rows 256 --columns 256
```

The first measures this machine against plain NumPy and SciPy in one run (`--quick` leaves out 100,000 vertices);
[benchmarks/results.md](benchmarks/results.md) has its tables from one run on a 2-core AMD machine (Zen 3, AVX2) with
CHOLMOD and PARDISO (`pip install cvxopt pypardiso`), and some again from processors with AVX-512 and a GPU. The
second steps a sheet of springs over MPI ranks (extra `mpi`): on a 2-core machine a step of 256 x 256 masses to 1e-12
took 8.7, 6.2 and 6.5 s on 1, 2 and 4 ranks, and 6.1 and 3.3 s on one and two threads of one process. Ranks gain memory
there, not time.

On one thread of an AMD EPYC (Zen 5) `simulate` computes 5,200 MWTS, 660 RSW and 4,500 reduced RSW frames a second at
13,300 vertices with 4 modes. A crowd of 4,096 paper birds of 493 vertices gets 1.34 million MWTS shapes a second with
AVX-512, which is 2.1 times the rate of its two matrix products alone by OpenBLAS's AVX2 kernels and 1.6 by its AVX-512
kernels, and 0.67 million with AVX2 alone, as many as the products.

## All studies

| study | picture | finding |
|---|---|---|
"""
TUTORIALS = """
## Tutorials

Scripts in cells (`# %%`) and the same as notebooks with their outputs, which `python -m studies.notebooks` makes. Run a
script, `python -m studies.tutorials.first_film`, or open it in an editor that knows cells; it writes into the working
folder.

| tutorial | question |
|---|---|
"""
PAPER = {
    "3": "A creature of 13,000 vertices with four modes on moving ground, in real time. "
    "`python -m studies.creature --vertices 100000 --out FILE` makes a larger one.",
    "4": "A fold stiffens a beam: flat and V-beams at flexure x1, x10, x100.",
    "5": "Three loads, three models side by side: LMA lengthens, MWTS and DS bend.",
    "6a": "Displacement error over the load.",
    "6b": "Area change over the load.",
    "7": "A beam manipulated at its tip. Prescribing both position and rotation costs far more energy than in DS, "
    "because the modes cannot represent the bend.",
    "8": "A dancer whose hat, shirt and trouser legs are shells on a skeleton of 17 joints.",
}
"""The paper's figures, and what each shows."""
FAILED = """
## Tried, and not kept

* Coordinates along a snap's path: one function of one variable whose minima are a load's stable states, made of the
  path of equilibria of the stiff V-beam. Under 32 loads of the family that it was made with, one such function was off
  DS by 0.42 % in the median, but by 90 % at the 90th percentile; four of them together by 1.6 %. No model came of it,
  and its study was removed.
"""
SCENES = """
## Scenes

```sh
modalshell run studies/scenes/leaf_wind.toml
```

runs one. `modalshell reproduce --pages` writes the web pages into `results/pages`. Those up to 500 kB are committed; of
each larger one the table has the command. Download or make a page and open it: it needs no server and no network, only
a browser with WebGL2. A page computes its scene live, or plays what a run gave where live models would leave something
out, and says which. The flock's run makes [a film](../paper_figures/flock.mp4) and reports the largest error of
its levels of detail in pixels.

| scene | page | what it is |
|---|---|---|
"""


def take(results: Path, name: str) -> None:
    """Make the page and the findings of a run those that are committed."""
    findings = json.loads((results / f"{name}.json").read_text(encoding="utf-8"))
    write_text(FOLDER / f"{name}.json", json.dumps(findings, separators=(",", ":")) + "\n")
    write_text(FOLDER / f"{name}.md", (results / f"{name}.md").read_text(encoding="utf-8"))


def paper_figure(number: str, caption: str) -> str:
    """The line of one figure of the paper."""
    film = f"../paper_figures/figure_{number}.mp4"
    link = f", [film]({film})" if (FOLDER / film).is_file() else ""
    return f"| [Fig. {number}](../paper_figures/figure_{number}.png){link} | {caption} |\n"


def described(picture: str) -> str:
    """What a picture shows: the first sentence of the module that draws it, without the study that it reads."""
    source = (FOLDER / picture).with_suffix(".py").read_text(encoding="utf-8")
    first = (ast.get_docstring(ast.parse(source)) or "").split("\n\n")[0].replace("\n", " ")
    told = re.sub(r"\s*\([^)]*[a-z]_[a-z][^)]*\)", "", first)  # names of studies
    told = re.sub(r"\s*\(reads[^)]*\)", "", told).replace("``", "").rstrip(".")
    return html.escape(told).replace("&#x27;", "'")


def row(name: str) -> str:
    """The line of one study."""
    study = studies()[name]
    title = (study.__doc__ or name).strip().splitlines()[0].rstrip(".")
    pictures = [f"../paper_figures/{figure}.png" for figure in study.FIGURES]
    picture = next((path for path in pictures if (FOLDER / path).is_file()), None)
    shown = "" if picture is None else f'[<img src="{picture}" width="320" alt="{described(picture)}">]({picture})'
    return f"| [**{name}**]({name}.md)<br>{title} | {shown} | {study.finding(committed(name))} |\n"


def scenes() -> str:
    """The scenes, with the web page of each, or the command that makes it where it is not committed."""
    lines = []
    for file in sorted((FOLDER / "scenes").glob("*.toml")):
        about = file.read_text(encoding="utf-8").splitlines()[0].lstrip("# ")
        committed = file.with_suffix(".html").is_file()
        command = f"`modalshell page studies/scenes/{file.name} --out {file.stem}.html`"
        moving = f"[moving](scenes/{file.stem}.html)" if committed else command
        lines.append(f"| [{file.stem}](scenes/{file.name}) | {moving} | {about} |\n")
    return SCENES + "".join(lines)


def tutorials() -> str:
    """The tutorials, with the question of each."""
    lines = []
    for file in sorted((FOLDER / "tutorials").glob("[!_]*.py")):
        about = file.read_text(encoding="utf-8").splitlines()[0].strip('"')
        names = f"[{file.stem}](tutorials/{file.name}), [notebook](tutorials/{file.stem}.ipynb)"
        lines.append(f"| {names} | {about} |\n")
    return TUTORIALS + "".join(lines)


def page() -> str:
    """The whole page."""
    figures = "".join(paper_figure(number, caption) for number, caption in PAPER.items())
    return HEAD + figures + BENCHMARKS + "".join(map(row, studies())) + FAILED + tutorials() + scenes()


if __name__ == "__main__":
    for study in sys.argv[2:]:
        take(Path(sys.argv[1]), study)
    print(write_text(FOLDER / "README.md", page()))
