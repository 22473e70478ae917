"""The static site: formulas, links, places, notebooks; whole, without a network."""

import re

import pytest

pytest.importorskip("latex2mathml", reason="latex2mathml is not installed (extra docs)")
pytest.importorskip("pygments", reason="pygments is not installed (extra docs)")

from guide import ROOT

from studies import site as studies_site
from studies.site import SiteError, broken_links, build, write_reference
from studies.site_text import formula_html, linked_text, markdown_html, with_formulas
from studies.site_tutorials import cells, notebook_html


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    build(folder, reference=False, run_tutorials=False)
    return folder


def test_the_site_is_whole_and_needs_no_network(site):
    assert broken_links(site) == []
    pages = [path for path in site.rglob("*.html") if "scenes" not in path.parts]
    assert len(pages) > 60
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert not re.search(r'<(?:script|link|img)[^>]*(?:src|href)="https?:', text), path
        assert "\ue000" not in text, path


def test_every_chapter_has_its_formulas_and_places(site):
    for source in sorted((ROOT / "studies" / "theory").glob("chapter_*.md")):
        text = (site / "studies" / "theory" / f"{source.stem}.html").read_text(encoding="utf-8")
        numbers = re.findall(r"\\tag\{(\d+)\}", source.read_text(encoding="utf-8"))
        assert re.findall(r'<div class="equation" id="eq-(\d+)">', text) == numbers
        body = re.sub(r"<(pre|code|math).*?</\1>", "", text, flags=re.DOTALL)
        assert not re.search(r"\\[a-zA-Z]+|\$", body), source.name


def test_pages_link_what_they_cite(site):
    text = (site / "studies" / "theory" / "chapter_04_split_folds.html").read_text(encoding="utf-8")
    assert 'href="../../references.html#' in text
    shown = linked_text("<p>see theory 4,\neq. 7 and choi2007; not <code>x</code></p>", "../", ROOT / "studies/theory")
    assert '<a href="../studies/theory/chapter_04_split_folds.html#eq-7">theory 4,\neq. 7</a>' in shown
    assert '<a href="../references.html#choi2007">choi2007</a>' in shown
    assert linked_text('<a href="#x">theory 4</a>', "", ROOT / "studies/theory") == '<a href="#x">theory 4</a>'


def test_formulas_become_mathml_and_unknown_commands_are_refused():
    made = formula_html(r"\frac{a}{b} \lt c \tag{3}", display=True)
    assert made.startswith('<div class="equation" id="eq-3"><math')
    assert "<mfrac>" in made
    assert "&#x0003C;" in made or "&lt;" in made
    with pytest.raises(ValueError, match="no command that MathML has"):
        formula_html(r"\nosuchcommand x")
    assert "<math" in formula_html(r"a , \quadC_b")  # as pdoc joins lines
    assert "<math" in with_formulas(r"<p>\( x_{1} \)</p>")
    assert with_formulas(r"<pre>\( x \)</pre>") == r"<pre>\( x \)</pre>"
    text = markdown_html("# A title, too\n\nWith $x_1$ and `$HOME`.\n\n```sh\necho $PATH $HOME\n```\n")
    assert text.count("<math") == 1
    assert '<h1 id="a-title-too">' in text


def test_a_dead_link_ends_the_build(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html">x</a> <a href="#there">y</a> <a href="#here">z</a></p>'
    )
    assert sorted(broken_links(tmp_path)) == ["a.html: #there", "a.html: b.html"]
    assert issubclass(SiteError, Exception)


def test_a_notebook_shows_what_its_cells_print_and_draw(tmp_path):
    script = tmp_path / "toy.py"
    script.write_text(
        '"""What is two and two?"""\n\n# %% [markdown]\n# # A sum\n#\n# of $x$\n\n# %%\ntotal = 2 + 2\nprint(total)\n'
        "import pathlib\npathlib.Path('plot.png').write_bytes(b'picture')\n\n# %%\nprint(total + 1)\n"
    )
    assert [kind for kind, _ in cells(script.read_text())] == ["markdown", "code", "code"]
    made = notebook_html(script, tmp_path / "pictures", True)
    assert '<pre class="output">4\n</pre>' in made
    assert '<pre class="output">5\n</pre>' in made
    assert '<img src="toy_plot.png"' in made
    assert (tmp_path / "pictures" / "toy_plot.png").read_bytes() == b"picture"
    assert "<math" in made
    assert 'class="output"' not in notebook_html(script, tmp_path / "pictures", False)


@pytest.mark.slow
def test_the_reference_draws_its_formulas_and_links_the_theory(tmp_path):
    pytest.importorskip("pdoc", reason="pdoc is not installed (extra docs)")
    write_reference(tmp_path)
    pages = [path.read_text(encoding="utf-8") for path in (tmp_path / "api").rglob("*.html")]
    shown = [re.sub(r"<(script|pre)\b.*?</\1>", "", page, flags=re.DOTALL) for page in pages]
    assert sum(page.count("<math") for page in shown) >= 5
    assert not any(re.search(r"\\\(|\$\$", page) for page in shown)
    assert any("studies/theory/chapter_08_equilibria.html#eq-7" in page for page in shown)


def test_a_site_without_its_packages_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(studies_site, "_NEEDED", ("pygments", "no_such_package"))
    with pytest.raises(SystemExit, match=r"not installed \(no_such_package\): pip install '\.\[docs\]'"):
        studies_site.main([str(tmp_path / "site")])
    assert not (tmp_path / "site").exists()
